// Where people were last known to be: dashed circles that hold the person nine times in ten, as a
// witness said. Rule: they are told apart from what the radio found by their ink, which no other layer has.
import type { Store } from "../store";
import { metres, shortId } from "../units";
import type { LastKnownRow, Place, TargetRow } from "../wire";
import { circle, shifted } from "./geometry";
import { BOLD, collection, feature, picks, type MapLayer } from "./layer";

/** The middle; nobody said how high. */
export const middleOf = (known: LastKnownRow): Place => ({ latitude_deg: known.latitude_deg, longitude_deg: known.longitude_deg, altitude_amsl_m: 0 });

export const places = (store: Store): LastKnownRow[] => store.mission?.last_known ?? [];

/** What is known of one beacon: of it, of an id joined into it, or of any of them. */
export function placesOf(store: Store, row: TargetRow): LastKnownRow[] {
  const ids = [row.beacon_id, ...row.joined_beacon_ids];
  return places(store).filter(({ beacon_id }) => beacon_id === null || ids.includes(beacon_id));
}

/** Whether it says something of the beacon that is picked, or nothing is. */
function concerns(store: Store, known: LastKnownRow, selected: string): boolean {
  const picked = [...store.targets.values()].find(({ beacon_id }) => picks(selected, beacon_id));
  return picked === undefined || placesOf(store, picked).includes(known);
}

export const lastKnown: MapLayer = {
  id: "places",
  tables: ["mission", "targets"],
  followsSelection: true,
  pointable: ["places-line", "places-label"],
  draw: (palette) => {
    const clear = (opacity: number): ["case", ["get", string], number, number] => ["case", ["get", "dim"], opacity / 5, opacity];
    return [
      // A light edge keeps the dashes in sight on the darkest squares of the search map.
      { id: "places-edge", type: "line", source: "places", filter: ["==", ["geometry-type"], "Polygon"], paint: { "line-color": palette.halo, "line-width": 4.5, "line-opacity": clear(0.75) } },
      { id: "places-line", type: "line", source: "places", filter: ["==", ["geometry-type"], "Polygon"], paint: { "line-color": palette.text, "line-width": 2, "line-dasharray": [4, 3], "line-opacity": clear(1) } },
      {
        id: "places-label", type: "symbol", source: "places", filter: ["==", ["geometry-type"], "Point"],
        layout: { "text-field": ["get", "label"], "text-font": BOLD, "text-size": 12, "text-variable-anchor": ["bottom", "top", "left", "right"], "text-radial-offset": 0.3, "text-allow-overlap": true },
        paint: { "text-color": palette.text, "text-halo-color": palette.halo, "text-halo-width": 2, "text-opacity": clear(1) },
      },
    ];
  },
  data: (store, view) => {
    const found = [];
    for (const known of places(store)) {
      const of = known.beacon_id === null ? "" : `beacon ${shortId(known.beacon_id)}`;
      const facts = {
        dim: !concerns(store, known, view.selected),
        tip: `${known.name || "Last known place"}\nwithin ${metres(known.radius_m)} nine times in ten, as was said before the search\n${of || "of any beacon"}`,
        select: known.beacon_id === null ? "" : `target:${known.beacon_id}`,
      };
      const name = known.name === "" ? "" : `${known.name}: `;
      found.push(feature({ type: "Polygon", coordinates: [circle(middleOf(known), known.radius_m)] }, facts));
      found.push(feature({ type: "Point", coordinates: shifted(middleOf(known), 0, known.radius_m) }, { ...facts, label: `${name}last known, ${metres(known.radius_m)}${of && `\n${of}`}` }));
    }
    return collection(found);
  },
};
