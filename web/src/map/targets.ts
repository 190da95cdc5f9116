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
        // The label stands on whichever side no vehicle, proposal or other label is; it is never left out.
        // Two ids of one phone lie on one spot: their markers must not block every side.
        "text-field": ["get", "label"], "text-font": BOLD, "text-size": 13, "text-variable-anchor": ["top", "bottom", "left", "right"],
        "text-radial-offset": 1.1, "text-justify": "auto", "text-allow-overlap": true,
      },
      // Not the marker's colour: on the squares of the search map that could not be read.
      paint: { "text-color": palette.text, "text-halo-color": palette.halo, "text-halo-width": 2.5 },
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
