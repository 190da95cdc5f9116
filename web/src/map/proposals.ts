// Places offered to the operator, and places where vehicles were just sent.
import { distance_m, metres } from "../units";
import { isOver } from "../panels/phases";
import { BOLD, collection, feature, line, point, type MapLayer } from "./layer";

export const proposals: MapLayer = {
  id: "proposals",
  tables: ["proposals", "commands", "vehicles"],
  pointable: ["proposals-point"],
  draw: (palette) => [
    { id: "proposals-line", type: "line", source: "proposals", filter: ["==", ["get", "what"], "offer"], paint: { "line-color": palette.proposal, "line-width": 2, "line-dasharray": [2, 1.5] } },
    { id: "proposals-sent-line", type: "line", source: "proposals", filter: ["==", ["get", "what"], "sent"], paint: { "line-color": palette.proposal, "line-width": 3 } },
    {
      id: "proposals-point", type: "symbol", source: "proposals", filter: ["==", ["geometry-type"], "Point"],
      layout: {
        "icon-image": ["get", "icon"], "icon-allow-overlap": true,
        "text-field": ["get", "label"], "text-font": BOLD, "text-size": 13, "text-allow-overlap": true, "text-ignore-placement": true,
      },
      paint: { "text-color": ["match", ["get", "icon"], "place-sent", palette.halo, palette.proposal] },
    },
  ],
  data: (store) => {
    const found = [];
    for (const row of store.proposals.values()) {
      const from = store.vehicles.get(row.vehicle_id)?.position;
      if (from) found.push(feature(line(from, row.position), { what: "offer" }));
      const far = from ? `, ${metres(distance_m(from, row.position))} away` : "";
      found.push(
        feature(point(row.position), {
          icon: "place-offer", label: String(row.vehicle_id), select: `proposal:${row.proposal_id}`,
          tip: `Proposed for vehicle ${row.vehicle_id}${far}\nat ${metres(row.height_above_home_m)} above home\n${row.reason}`,
        }),
      );
    }
    for (const row of store.commands.values()) {
      if (row.kind !== "reposition" || row.target === null || isOver(row.phase)) continue;
      const from = store.vehicles.get(row.vehicle_id)?.position;
      if (from) found.push(feature(line(from, row.target), { what: "sent" }));
      found.push(feature(point(row.target), { icon: "place-sent", label: String(row.vehicle_id), select: `vehicle:${row.vehicle_id}`, tip: `Vehicle ${row.vehicle_id} sent here\n${row.phase}` }));
    }
    return collection(found);
  },
};
