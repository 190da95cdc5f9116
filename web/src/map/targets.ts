// Beacons: the estimate, with how far from it one must search.
import { coordinates, metres, shortId } from "../units";
import { BOLD, collection, feature, point, type MapLayer } from "./layer";

export const targets: MapLayer = {
  id: "targets",
  tables: ["targets"],
  pointable: ["targets-point"],
  draw: (palette) => [
    {
      id: "targets-point", type: "symbol", source: "targets",
      layout: {
        "icon-image": "beacon", "icon-allow-overlap": true, "icon-ignore-placement": true,
        "text-field": ["get", "label"], "text-font": BOLD, "text-size": 13, "text-anchor": "top", "text-offset": [0, 0.8],
        "text-allow-overlap": true, "text-ignore-placement": true,
      },
      paint: { "text-color": palette.target, "text-halo-color": palette.halo, "text-halo-width": 2.5 },
    },
  ],
  data: (store) => {
    const found = [];
    for (const row of store.targets.values()) {
      if (row.position === null) continue;
      found.push(
        feature(point(row.position), {
          label: row.radius_90_m === null ? shortId(row.beacon_id) : `${shortId(row.beacon_id)} · ${metres(row.radius_90_m)}`,
          tip: `Beacon ${row.beacon_id}\n${coordinates(row.position)}\n90 % within ${metres(row.radius_90_m)}\n${row.environment.toUpperCase()}, ${row.los_links ?? 0} of ${row.links} links line of sight`,
          select: `target:${row.beacon_id}`,
        }),
      );
    }
    return collection(found);
  },
};
