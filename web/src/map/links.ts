// Radio links as lines from vehicle to beacon: colour and width are P(LOS), dashes mean that
// nobody classified the link.
import type { ExpressionSpecification } from "maplibre-gl";
import { linkKey } from "../store";
import type { Palette } from "../themes/palette";
import { dbm, probability, shortId } from "../units";
import type { LinkRow } from "../wire";
import { collection, feature, line, type MapLayer } from "./layer";

const colour = (palette: Palette): ExpressionSpecification => [
  "interpolate", ["linear"], ["get", "los"], 0, palette.los[0], 0.5, palette.los[1], 1, palette.los[2],
];

export const isClassified = (row: LinkRow): boolean => row.los_probability !== null && row.los_source !== "prior";

export const links: MapLayer = {
  id: "links",
  tables: ["links", "vehicles", "targets"],
  pointable: ["links-known", "links-unknown"],
  followsSelection: true,
  draw: (palette) => [
    {
      id: "links-unknown", type: "line", source: "links", filter: ["!", ["get", "classified"]],
      paint: { "line-color": palette.unclassified, "line-width": 1.6, "line-dasharray": [2, 2], "line-opacity": ["case", ["get", "dim"], 0.12, 0.7] },
    },
    {
      id: "links-known", type: "line", source: "links", filter: ["get", "classified"],
      paint: { "line-color": colour(palette), "line-width": ["interpolate", ["linear"], ["get", "los"], 0, 1.4, 1, 4.5], "line-opacity": ["case", ["get", "dim"], 0.12, ["interpolate", ["linear"], ["get", "los"], 0, 0.6, 1, 0.95]] },
    },
  ],
  data: (store, view) => {
    const found = [];
    const picked = (row: LinkRow): boolean =>
      [`link:${linkKey(row)}`, `vehicle:${row.vehicle_id}`, `target:${row.beacon_id}`].includes(view.selected);
    // With a vehicle, a beacon or a link picked, the other links step back.
    const focus = [...store.links.values()].some(picked);
    for (const row of store.links.values()) {
      const from = store.vehicles.get(row.vehicle_id)?.position;
      const target = store.targets.get(row.beacon_id);
      const to = (target?.joined_into ? store.targets.get(target.joined_into) : target)?.position;
      if (!from || !to) continue;
      const classified = isClassified(row);
      const verdict = classified ? `P(LOS) ${probability(row.los_probability)}, by ${row.los_source}` : `unclassified${row.los_reason ? `: ${row.los_reason}` : ""}`;
      found.push(
        feature(line(from, to), {
          classified,
          dim: focus && !picked(row),
          los: row.los_probability ?? 0.5,
          tip: `Link vehicle ${row.vehicle_id} – beacon ${shortId(row.beacon_id)}\n${verdict}\n${dbm(row.rss_dbm)}, ${row.samples_total} samples`,
          select: `link:${linkKey(row)}`,
        }),
      );
    }
    return collection(found);
  },
};
