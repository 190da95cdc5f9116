// Where the people may be (search area) and where vehicles may go (fence).
import { BOLD, collection, feature, type MapLayer } from "./layer";

export const mission: MapLayer = {
  id: "mission",
  tables: ["mission"],
  draw: (palette) => [
    { id: "mission-area", type: "fill", source: "mission", filter: ["==", ["get", "what"], "area"], paint: { "fill-color": palette.area, "fill-opacity": 0.06 } },
    { id: "mission-area-line", type: "line", source: "mission", filter: ["==", ["get", "what"], "area"], paint: { "line-color": palette.area, "line-width": 2, "line-dasharray": [4, 2] } },
    { id: "mission-fence-line", type: "line", source: "mission", filter: ["==", ["get", "what"], "fence"], paint: { "line-color": palette.fence, "line-width": 2.5 } },
    {
      id: "mission-labels", type: "symbol", source: "mission", filter: ["==", ["geometry-type"], "Point"],
      layout: { "text-field": ["get", "label"], "text-font": BOLD, "text-size": 12, "text-anchor": "bottom-left", "text-offset": [0.2, -0.2] },
      paint: { "text-color": ["match", ["get", "of"], "fence", palette.fence, palette.area], "text-halo-color": palette.halo, "text-halo-width": 1.5 },
    },
  ],
  data: (store) => {
    const found = [];
    for (const [what, area, title] of [["area", store.mission?.search_area, "search area"], ["fence", store.mission?.fence, "fence"]] as const) {
      if (!area) continue;
      found.push(feature({ type: "MultiPolygon", coordinates: area.polygons_deg as never }, { what }));
      for (const polygon of area.polygons_deg) {
        // The label stands at the north-west corner: the least likely to be under something.
        const corner = [...(polygon[0] ?? [])].sort((a, b) => (b[1] ?? 0) - (a[1] ?? 0) + ((a[0] ?? 0) - (b[0] ?? 0)) / 2)[0];
        if (corner) found.push(feature({ type: "Point", coordinates: corner }, { label: area.name.includes(title) ? area.name : `${area.name} ${title}`.trim(), of: what }));
      }
    }
    return collection(found);
  },
};
