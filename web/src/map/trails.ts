// Where the vehicles were a moment ago: the last stretch only, fading, so that it shows the
// way and hides nothing.
import { collection, feature, type MapLayer } from "./layer";

const DRAWN_POINTS = 30;

export const trails: MapLayer = {
  id: "trails",
  tables: ["trails"],
  source: { lineMetrics: true },
  draw: (palette) => [
    {
      id: "trails-line", type: "line", source: "trails", layout: { "line-join": "round" },
      paint: { "line-width": 2, "line-gradient": ["interpolate", ["linear"], ["line-progress"], 0, `${palette.trail}00`, 1, `${palette.trail}aa`] },
    },
  ],
  data: (store) =>
    collection(
      [...store.trails.values()]
        .map((points) => points.slice(-DRAWN_POINTS))
        .filter((points) => points.length > 1)
        .map((points) => feature({ type: "LineString", coordinates: points })),
    ),
};
