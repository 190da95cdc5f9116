// Numbers for people: every one leaves here with its unit. Pure.
import type { Place } from "./wire";

const METRES_PER_DEGREE = 111_320;
const NONE = "–";
const NOW_S = 3;

export function metres(value_m: number | null | undefined, digits = 0): string {
  if (value_m === null || value_m === undefined || !Number.isFinite(value_m)) return NONE;
  if (Math.abs(value_m) >= 10_000) return `${(value_m / 1000).toFixed(1)} km`;
  return `${value_m.toFixed(digits)} m`;
}

export function dbm(value_dbm: number | null | undefined): string {
  return value_dbm === null || value_dbm === undefined ? NONE : `${value_dbm.toFixed(0)} dBm`;
}

export function percent(value: number | null | undefined): string {
  return value === null || value === undefined ? NONE : `${value.toFixed(0)} %`;
}

export function probability(value: number | null | undefined): string {
  return value === null || value === undefined ? NONE : `${(value * 100).toFixed(0)} %`;
}

/** An age in seconds, short enough for a table. */
export function age(value_s: number | null | undefined): string {
  if (value_s === null || value_s === undefined || !Number.isFinite(value_s)) return NONE;
  const whole_s = Math.max(0, Math.floor(value_s));
  if (whole_s < 60) return `${whole_s} s`;
  if (whole_s < 3600) return `${Math.floor(whole_s / 60)} min ${String(whole_s % 60).padStart(2, "0")} s`;
  return `${Math.floor(whole_s / 3600)} h ${String(Math.floor((whole_s % 3600) / 60)).padStart(2, "0")} min`;
}

/** How far something may be off, seconds: rounded up, for it is a bound. */
export function uncertainty(value_s: number | null | undefined): string {
  if (value_s === null || value_s === undefined || !Number.isFinite(value_s)) return NONE;
  // A product like 0.003 · 1000 lies above 3 by rounding alone.
  const whole_ms = Math.ceil(value_s * 1000 - 1e-6);
  return whole_ms < 1000 ? `± ${whole_ms} ms` : `± ${(Math.ceil(whole_ms / 100) / 10).toFixed(1)} s`;
}

/** How long ago something was heard; what comes every second or two is steady for the eye. */
export function heardAge(value_s: number | null | undefined): string {
  return value_s !== null && value_s !== undefined && value_s < NOW_S ? "now" : age(value_s);
}

/** Latitude and longitude as other tools take them: degrees, six decimals (0.1 m). */
export function coordinates(place: Place): string {
  return `${place.latitude_deg.toFixed(6)}, ${place.longitude_deg.toFixed(6)}`;
}

/** Nanoseconds as a decimal string to milliseconds; 2⁵³ is passed only in nanoseconds. */
export function milliseconds(time_ns: string): number {
  return Number(BigInt(time_ns) / 1_000_000n);
}

export function clockTime(time_ns: string): string {
  const date = new Date(milliseconds(time_ns));
  return [date.getHours(), date.getMinutes(), date.getSeconds()].map((part) => String(part).padStart(2, "0")).join(":");
}

/** East and north metres from one place to another, on the tangent plane: good within kilometres. */
export function offset_m(from: Place, to: Place): [number, number] {
  const scale = Math.cos((from.latitude_deg * Math.PI) / 180);
  return [
    (to.longitude_deg - from.longitude_deg) * METRES_PER_DEGREE * scale,
    (to.latitude_deg - from.latitude_deg) * METRES_PER_DEGREE,
  ];
}

export function distance_m(from: Place, to: Place): number {
  return Math.hypot(...offset_m(from, to));
}

const POINTS = ["N", "NE", "E", "SE", "S", "SW", "W", "NW"] as const;

/** The compass point in which `to` lies, seen from `from`. */
export function compass(from: Place, to: Place): string {
  const [east, north] = offset_m(from, to);
  const turn = (Math.atan2(east, north) / (2 * Math.PI) + 1) % 1;
  return POINTS[Math.round(turn * 8) % 8] ?? "N";
}

/** A number and its unit stay on one line. */
export function unbroken(text: string): string {
  return text.replace(/(\d) (?=(?:m|km|s|min|dB|dBm)\b|%)/g, "$1\u00a0");
}

/** Ids of radios are long: the last digits tell them apart, the whole stands in the title. */
export function shortId(beacon_id: string): string {
  return beacon_id.length > 8 ? `…${beacon_id.slice(-6)}` : beacon_id;
}
