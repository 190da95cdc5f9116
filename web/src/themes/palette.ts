// Colours of the map, one palette a theme; those of the panels are in page.css.
// P(LOS) runs from orange to blue, which colour-blind eyes tell apart, and its width grows too.
export type ThemeName = "light" | "dark";

export interface Palette {
  background: string;
  grid: string;
  gridText: string;
  text: string;
  halo: string;
  los: [string, string, string];
  unclassified: string;
  /** Search map, where to search first to last: `CLASSES` of map/searchmap.ts. */
  search: [string, string, string, string, string, string, string];
  target: string;
  targetFill: string;
  vehicle: string;
  vehicleLost: string;
  proposal: string;
  trail: string;
  area: string;
  fence: string;
}

export const palettes: Record<ThemeName, Palette> = {
  light: {
    background: "#eef0ea", grid: "#cdd2c6", gridText: "#4d5548", text: "#111111", halo: "#ffffff",
    los: ["#c44601", "#a8895a", "#0a5ea8"], unclassified: "#666666",
    search: ["#3f0028", "#6e0043", "#a1005f", "#c93a8b", "#df7cb3", "#ecabce", "#f4cfe2"],
    target: "#a1005f", targetFill: "#c2187a", vehicle: "#14324f", vehicleLost: "#8a8a8a",
    proposal: "#00695c", trail: "#5b7796", area: "#6b5500", fence: "#b00020",
  },
  dark: {
    background: "#11161b", grid: "#2a333b", gridText: "#9fb0bd", text: "#f4f6f8", halo: "#0b0f13",
    los: ["#ff8a3d", "#d2bd92", "#58b2ff"], unclassified: "#a9a9a9",
    search: ["#fff0f8", "#ffc2e3", "#ff8fcf", "#d860a3", "#a23d77", "#742a55", "#4b1f3a"],
    target: "#ff7ac6", targetFill: "#ff5cb5", vehicle: "#dbe9f6", vehicleLost: "#7d8790",
    proposal: "#4fd6bd", trail: "#6d8aa6", area: "#e0c15c", fence: "#ff7a85",
  },
};
