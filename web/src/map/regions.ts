// Where to search: nested areas that hold 50, 90 and 95 % of the belief. Where tracking drew
// none lately, the 90 % circle and the shape of the covariance stand for them.
import type { ExpressionSpecification } from "maplibre-gl";
import type { Store } from "../store";
import { milliseconds } from "../units";
import type { RegionsRow, TargetRow } from "../wire";
import { circle, ellipse90, ellipseRing } from "./geometry";
import { collection, feature, picks, type MapLayer } from "./layer";

/** Regions this much older than the belief say nothing of it any more; they come every two seconds. */
export const OLD_MS = 15_000;

export function regionsOf(store: Store, row: TargetRow): RegionsRow | null {
  const found = store.regions.get(row.beacon_id);
  if (row.position === null || found === undefined || found.regions.length === 0) return null;
  return milliseconds(row.time_ns) - milliseconds(found.time_ns) > OLD_MS ? null : found;
}

const of = (what: string): ["==", ["get", string], string] => ["==", ["get", "what"], what];

const clear = (opacity: number): ExpressionSpecification => ["case", ["get", "dim"], opacity / 5, opacity];

export const regions: MapLayer = {
  id: "regions",
  tables: ["regions", "targets"],
  followsSelection: true,
  draw: (palette) => [
    // The opacities add up inwards: the likeliest place is the strongest colour.
    { id: "regions-95", type: "fill", source: "regions", filter: of("95"), paint: { "fill-color": palette.targetFill, "fill-opacity": clear(0.1) } },
    { id: "regions-90", type: "fill", source: "regions", filter: of("90"), paint: { "fill-color": palette.targetFill, "fill-opacity": clear(0.16) } },
    { id: "regions-50", type: "fill", source: "regions", filter: of("50"), paint: { "fill-color": palette.targetFill, "fill-opacity": clear(0.3) } },
    { id: "regions-90-line", type: "line", source: "regions", filter: of("90"), paint: { "line-color": palette.target, "line-width": 2, "line-opacity": clear(1) }, layout: { "line-join": "round" } },
    { id: "regions-50-line", type: "line", source: "regions", filter: of("50"), paint: { "line-color": palette.target, "line-width": 1, "line-opacity": clear(0.5) }, layout: { "line-join": "round" } },
    { id: "regions-circle", type: "fill", source: "regions", filter: of("circle"), paint: { "fill-color": palette.targetFill, "fill-opacity": clear(0.16) } },
    { id: "regions-circle-line", type: "line", source: "regions", filter: of("circle"), paint: { "line-color": palette.target, "line-width": 2, "line-opacity": clear(1) } },
    { id: "regions-ellipse", type: "line", source: "regions", filter: of("ellipse"), paint: { "line-color": palette.target, "line-width": 1.2, "line-opacity": clear(1), "line-dasharray": [3, 2] } },
  ],
  data: (store, view) => {
    const found = [];
    // With a beacon or one of its links picked, the other beacons' areas step back.
    const picked = [...store.targets.keys()].find((beacon_id) => picks(view.selected, beacon_id));
    for (const row of store.targets.values()) {
      if (row.position === null) continue;
      const dim = picked !== undefined && picked !== row.beacon_id;
      const drawn = regionsOf(store, row);
      if (drawn !== null) {
        for (const region of drawn.regions) {
          found.push(feature({ type: "MultiPolygon", coordinates: region.polygons_deg as never }, { what: String(Math.round(region.share * 100)), dim }));
        }
        continue;
      }
      if (row.radius_90_m !== null) found.push(feature({ type: "Polygon", coordinates: [circle(row.position, row.radius_90_m)] }, { what: "circle", dim }));
      const shape = row.covariance_enu_m2 === null ? null : ellipse90(row.covariance_enu_m2);
      if (shape !== null) found.push(feature({ type: "Polygon", coordinates: [ellipseRing(row.position, shape)] }, { what: "ellipse", dim }));
    }
    return collection(found);
  },
};
