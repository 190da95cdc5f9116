// "Why do you think so?" in the operator's words. Pure.
import { middleOf } from "../map/places";
import { compass, distance_m, metres, shortId } from "../units";
import type { ContributionRow, LastKnownRow, TargetRow } from "../wire";

export interface Reason {
  vehicle_id: number;
  /** "42 %", "under 1 %". */
  share: string;
  weight: number;
  /** What speaks for or against it, the most important first; `odd`: to be looked at. */
  remarks: Remark[];
  windows: string;
}

/** Standard deviations from which on a residual is worth a number, is unusual, and does not fit. */
const NOTICED = 1;
const UNUSUAL = 2;
const MISFIT = 3;
/** Below this factor the others are surer without it. */
const CONTRADICTS = 0.8;
const LITTLE = 0.02;
/** Bearings of links that are hardly in line of sight point anywhere: by how much is no news. */
const LIKELY_LOS = 0.5;

interface Remark {
  text: string;
  odd: boolean;
}

const count = (value: number, one: string, many: string): string => `${value} ${value === 1 ? one : many}`;

const oddness = (score: number): string => (Math.abs(score) >= MISFIT ? " – does not fit" : Math.abs(score) >= UNUSUAL ? " – unusual" : "");

/** One standard deviation, for people. */
function spread(residual: number, score: number, unit: string): string {
  const std = score === 0 ? 0 : Math.abs(residual / score);
  return std > 0 ? ` (±${std.toFixed(std < 10 ? 1 : 0)}${unit})` : "";
}

function power(row: ContributionRow): Remark | null {
  const [residual_db, score] = [row.power_residual_db, row.power_score];
  if (residual_db === null || score === null) return null;
  if (Math.abs(score) < NOTICED) return { text: `its power fits the estimate${spread(residual_db, score, " dB")}`, odd: false };
  const text = `hears it ${Math.abs(residual_db).toFixed(0)} dB ${residual_db > 0 ? "stronger" : "weaker"} than the estimate explains${oddness(score)}`;
  return { text, odd: Math.abs(score) >= UNUSUAL };
}

function bearing(row: ContributionRow): Remark | null {
  const [aside_deg, aside] = [row.azimuth_residual_deg, row.azimuth_score];
  const [above_deg, above] = [row.elevation_residual_deg, row.elevation_score];
  if (aside_deg === null || aside === null || above_deg === null || above === null) return null;
  const parts: string[] = [];
  const degrees = (value: number): string => `${Math.abs(value).toFixed(Math.abs(value) < 10 ? 1 : 0)}°`;
  if (Math.abs(aside) >= NOTICED) parts.push(`${degrees(aside_deg)} to the ${aside_deg > 0 ? "right" : "left"} of`);
  if (Math.abs(above) >= NOTICED) parts.push(`${degrees(above_deg)} ${above_deg > 0 ? "above" : "below"}`);
  if (parts.length === 0) return { text: `its bearing fits the estimate${spread(aside_deg, aside, "°")}`, odd: false };
  const judged = row.los_probability !== null;
  if (row.los_probability !== null && row.los_probability < LIKELY_LOS) {
    return { text: "its bearing counts little (a reflection)", odd: false };
  }
  const worst = Math.max(Math.abs(aside), Math.abs(above));
  return { text: `its bearing points ${parts.join(" and ")} the estimate${judged ? oddness(worst) : ""}`, odd: judged && worst >= UNUSUAL };
}

export function reasonOf(row: ContributionRow): Reason {
  const remarks: Reason["remarks"] = [];
  if (row.area_factor < CONTRADICTS) {
    remarks.push({ text: `contradicts the others: without it the area would be ${row.area_factor.toFixed(1)} × as large`, odd: true });
  } else if (row.area_factor >= 1.2) {
    const factor = row.area_factor >= 100 ? "over 100" : row.area_factor.toFixed(row.area_factor < 10 ? 1 : 0);
    remarks.push({ text: `without it the area would be ${factor} × as large`, odd: false });
  } else if (row.weight < LITTLE) {
    remarks.push({ text: "adds little to what the others say", odd: false });
  }
  for (const remark of [power(row), bearing(row)]) if (remark !== null) remarks.push(remark);
  remarks.sort((a, b) => Number(b.odd) - Number(a.odd));
  remarks.push({ text: row.los_probability === null ? "line of sight not judged" : `line of sight: ${(row.los_probability * 100).toFixed(0)} % likely`, odd: false });
  const windows = [count(row.windows, "window", "windows")];
  if (row.redundant > 0) windows.push(`${row.redundant} more from the same places`);
  if (row.outliers > 0) windows.push(`${row.outliers} doubtful, weighed down`);
  return {
    vehicle_id: row.vehicle_id,
    share: row.weight < 0.005 ? "under 1 %" : `${(row.weight * 100).toFixed(0)} %`,
    weight: row.weight,
    remarks,
    windows: windows.join(", "),
  };
}

/** A last known place, and where the estimate lies from it. */
export function lastKnownText(known: LastKnownRow, row: TargetRow): string {
  const name = known.name === "" ? "" : `${known.name}, `;
  const of = known.beacon_id === null ? " (any beacon)" : known.beacon_id === row.beacon_id ? "" : ` (of ${shortId(known.beacon_id)})`;
  const place = row.position;
  if (place === null) return `Last known: ${name}within ${metres(known.radius_m)}${of}`;
  const middle = middleOf(known);
  const away_m = distance_m(middle, place);
  const where = away_m < 1 ? "the estimate is its middle" : `the estimate is ${metres(away_m)} ${compass(middle, place)} of its middle`;
  return `Last known: ${name}within ${metres(known.radius_m)}${of} · ${where}`;
}

/** The most telling first. */
export const reasonsOf = (rows: ContributionRow[]): Reason[] =>
  [...rows].sort((a, b) => b.weight - a.weight || a.vehicle_id - b.vehicle_id).map(reasonOf);
