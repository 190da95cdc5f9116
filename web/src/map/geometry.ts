// Shapes in metres on the tangent plane, as [longitude, latitude] rings. Pure.
import { offset_m } from "../units";
import type { Place } from "../wire";

export type LonLat = [number, number];

const METRES_PER_DEGREE = 111_320;
/** Quantile of chi-square with two degrees of freedom at 0.90. */
const CHI2_90 = 4.605_170_185_988_091;

export function shifted(place: Place, east_m: number, north_m: number): LonLat {
  const scale = Math.cos((place.latitude_deg * Math.PI) / 180);
  return [
    place.longitude_deg + east_m / (METRES_PER_DEGREE * scale),
    place.latitude_deg + north_m / METRES_PER_DEGREE,
  ];
}

export function circle(place: Place, radius_m: number, steps = 64): LonLat[] {
  return Array.from({ length: steps + 1 }, (_, step) => {
    const angle = (2 * Math.PI * (step % steps)) / steps;
    return shifted(place, radius_m * Math.cos(angle), radius_m * Math.sin(angle));
  });
}

export interface Ellipse {
  major_m: number;
  minor_m: number;
  /** Of the major axis, radians counter-clockwise from east. */
  angle_rad: number;
}

/** The horizontal 90 % ellipse of EE, EN, EU, NN, NU, UU; null when that is no covariance. */
export function ellipse90(covariance_enu_m2: number[]): Ellipse | null {
  const [ee, en, , nn] = covariance_enu_m2;
  if (ee === undefined || en === undefined || nn === undefined) return null;
  const mean = (ee + nn) / 2;
  const spread = Math.hypot((ee - nn) / 2, en);
  if (!(mean - spread >= 0) || mean <= 0) return null;
  return {
    major_m: Math.sqrt(CHI2_90 * (mean + spread)),
    minor_m: Math.sqrt(CHI2_90 * (mean - spread)),
    angle_rad: 0.5 * Math.atan2(2 * en, ee - nn),
  };
}

export function ellipseRing(place: Place, shape: Ellipse, steps = 64): LonLat[] {
  const [cos, sin] = [Math.cos(shape.angle_rad), Math.sin(shape.angle_rad)];
  return Array.from({ length: steps + 1 }, (_, step) => {
    const angle = (2 * Math.PI * (step % steps)) / steps;
    const [along, across] = [shape.major_m * Math.cos(angle), shape.minor_m * Math.sin(angle)];
    return shifted(place, along * cos - across * sin, along * sin + across * cos);
  });
}

export interface Bounds {
  west: number;
  south: number;
  east: number;
  north: number;
}

export function boundsOf(points: Iterable<readonly number[]>): Bounds | null {
  let bounds: Bounds | null = null;
  for (const [longitude, latitude] of points) {
    if (longitude === undefined || latitude === undefined) continue;
    bounds = bounds === null
      ? { west: longitude, east: longitude, south: latitude, north: latitude }
      : {
          west: Math.min(bounds.west, longitude), east: Math.max(bounds.east, longitude),
          south: Math.min(bounds.south, latitude), north: Math.max(bounds.north, latitude),
        };
  }
  return bounds;
}

/** 1, 2 or 5 times a power of ten: the smallest such spacing that leaves at most `wanted` lines across. */
export function gridSpacing_m(span_m: number, wanted = 6): number {
  const rough = Math.max(1, span_m / wanted);
  const power = 10 ** Math.floor(Math.log10(rough));
  const factor = [1, 2, 5, 10].find((step) => step * power >= rough * (1 - 1e-9)) ?? 10;
  return factor * power;
}

export interface GridLine {
  axis: "east" | "north";
  value_m: number;
  line: [LonLat, LonLat];
}

/** Lines of whole metres east and north of `origin` that cross the bounds. */
export function gridLines(origin: Place, bounds: Bounds, spacing_m: number, limit = 200): GridLine[] {
  const at = (longitude_deg: number, latitude_deg: number): Place => ({ latitude_deg, longitude_deg, altitude_amsl_m: 0 });
  const flat = (place: Place): [number, number] => {
    // The scale of the origin's latitude everywhere, or the lines would not be straight north.
    const [, north] = offset_m(origin, place);
    const east = (place.longitude_deg - origin.longitude_deg) * METRES_PER_DEGREE * Math.cos((origin.latitude_deg * Math.PI) / 180);
    return [east, north];
  };
  const [west_m, south_m] = flat(at(bounds.west, bounds.south));
  const [east_m, north_m] = flat(at(bounds.east, bounds.north));
  const lines: GridLine[] = [];
  for (let value = Math.ceil(west_m / spacing_m) * spacing_m; value <= east_m && lines.length < limit; value += spacing_m) {
    lines.push({ axis: "east", value_m: value, line: [shifted(origin, value, south_m), shifted(origin, value, north_m)] });
  }
  for (let value = Math.ceil(south_m / spacing_m) * spacing_m; value <= north_m && lines.length < limit; value += spacing_m) {
    lines.push({ axis: "north", value_m: value, line: [shifted(origin, west_m, value), shifted(origin, east_m, value)] });
  }
  return lines;
}
