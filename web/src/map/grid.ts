// Without a base map: a grid of whole metres east and north of the mission's origin.
import { collection, feature, FONT, type MapLayer, type View } from "./layer";
import { gridLines, gridSpacing_m } from "./geometry";
import { offset_m } from "../units";

/** Far enough apart for a label at each line. */
export function spacingOf({ bounds, width_px }: Pick<View, "bounds" | "width_px">): number {
  const middle = (bounds.south + bounds.north) / 2;
  const [east] = offset_m(
    { latitude_deg: middle, longitude_deg: bounds.west, altitude_amsl_m: 0 },
    { latitude_deg: middle, longitude_deg: bounds.east, altitude_amsl_m: 0 },
  );
  return gridSpacing_m(Math.abs(east), Math.max(2, width_px / 120));
}

export const grid: MapLayer = {
  id: "grid",
  tables: ["mission"],
  followsView: true,
  draw: (palette) => [
    { id: "grid-lines", type: "line", source: "grid", filter: ["==", ["geometry-type"], "LineString"], paint: { "line-color": palette.grid, "line-width": ["case", ["get", "axis0"], 2, 1] } },
    {
      id: "grid-labels", type: "symbol", source: "grid", filter: ["==", ["geometry-type"], "Point"],
      layout: { "text-field": ["get", "label"], "text-font": FONT, "text-size": 11, "text-anchor": "bottom-left", "text-offset": [0.3, -0.3], "text-allow-overlap": true },
      paint: { "text-color": palette.gridText, "text-halo-color": palette.background, "text-halo-width": 1.5 },
    },
  ],
  data: (_store, view) => {
    const lines = gridLines(view.origin, view.bounds, spacingOf(view));
    return collection(
      lines.flatMap(({ axis, value_m, line }) => {
        const whole = Math.round(value_m);
        const label = axis === "east" ? `${Math.abs(whole)} m ${whole < 0 ? "W" : "E"}` : `${Math.abs(whole)} m ${whole < 0 ? "S" : "N"}`;
        const [start] = line;
        return [
          feature({ type: "LineString", coordinates: line }, { axis0: whole === 0 }),
          feature({ type: "Point", coordinates: start }, { label: whole === 0 ? "0" : label, }),
        ];
      }),
    );
  },
};
