// The radius against time as a curve: logarithmic, because 200 m → 100 m and 10 m → 5 m are the
// same progress. Pure.
import { milliseconds } from "../units";
import type { HistoryPoint } from "../wire";

export interface Curve {
  /** SVG path over the unit box of `width` × `height`. */
  path: string;
  first_m: number;
  last_m: number;
  span_s: number;
  /** Radii with a line across, metres, and where. */
  lines: { radius_m: number; y: number }[];
}

const LEAST_M = 0.5;

export function curveOf(points: HistoryPoint[], width: number, height: number): Curve | null {
  const known = points.flatMap((point) => (point.radius_90_m === null ? [] : [{ time_ms: milliseconds(point.time_ns), radius_m: Math.max(point.radius_90_m, LEAST_M) }]));
  const first = known[0];
  const last = known[known.length - 1];
  if (first === undefined || last === undefined || last.time_ms <= first.time_ms) return null;
  const radii = known.map(({ radius_m }) => radius_m);
  // Half an octave of air, so that an even curve lies in the middle.
  const low = Math.log(Math.min(...radii)) - 0.2;
  const high = Math.log(Math.max(...radii)) + 0.2;
  const x = (time_ms: number): number => (width * (time_ms - first.time_ms)) / (last.time_ms - first.time_ms);
  const y = (radius_m: number): number => (height * (high - Math.log(radius_m))) / (high - low);
  const path = known.map(({ time_ms, radius_m }, index) => `${index === 0 ? "M" : "L"}${x(time_ms).toFixed(1)} ${y(radius_m).toFixed(1)}`).join("");
  const lines = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000]
    .filter((radius_m) => Math.log(radius_m) > low && Math.log(radius_m) < high)
    .map((radius_m) => ({ radius_m, y: y(radius_m) }));
  // Two lines are enough to read it by.
  const shown = lines.length <= 2 ? lines : [lines[0], lines[lines.length - 1]].flatMap((line) => line ?? []);
  return { path, first_m: first.radius_m, last_m: last.radius_m, span_s: (last.time_ms - first.time_ms) / 1000, lines: shown };
}
