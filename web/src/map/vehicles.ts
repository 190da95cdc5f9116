// Vehicles: the number on a disc whose nose points where the vehicle's does, and where the autopilot says it goes.
import { metres, percent } from "../units";
import { BOLD, collection, feature, line, point, type MapLayer } from "./layer";

export const vehicles: MapLayer = {
  id: "vehicles",
  tables: ["vehicles"],
  pointable: ["vehicles-point"],
  draw: (palette) => [
    { id: "vehicles-leg", type: "line", source: "vehicles", filter: ["==", ["get", "what"], "leg"], paint: { "line-color": palette.vehicle, "line-width": 1.5, "line-dasharray": [1, 2] } },
    {
      id: "vehicles-point", type: "symbol", source: "vehicles", filter: ["==", ["geometry-type"], "Point"],
      layout: {
        "icon-image": ["get", "icon"], "icon-rotate": ["get", "heading"], "icon-rotation-alignment": "map",
        "icon-allow-overlap": true,
        "text-field": ["get", "label"], "text-font": BOLD, "text-size": ["case", [">", ["length", ["get", "label"]], 2], 10, 13],
        "text-allow-overlap": true, "text-ignore-placement": true,
      },
      paint: { "text-color": palette.halo },
    },
  ],
  data: (store) => {
    const found = [];
    for (const row of store.vehicles.values()) {
      if (row.position === null) continue;
      if (row.position_target !== null && !row.lost) found.push(feature(line(row.position, row.position_target), { what: "leg" }));
      found.push(
        feature(point(row.position), {
          icon: `${row.heading_deg === null ? "vehicle-round" : "vehicle"}${row.lost ? "-lost" : ""}`,
          heading: row.heading_deg ?? 0,
          label: String(row.vehicle_id),
          tip: `Vehicle ${row.vehicle_id}: ${row.lost ? "LOST" : row.mode}\n${metres(row.height_above_home_m)} above home\nbattery ${percent(row.battery_percent)}`,
          select: `vehicle:${row.vehicle_id}`,
        }),
      );
    }
    return collection(found);
  },
};
