// Why a vehicle or a beacon has no proposal: the planner's notes, one a subject, the newest
// word of each. Pure.
import { milliseconds, shortId } from "../units";
import type { EventRow, ProposalRow } from "../wire";

export const PLAN_NOTE = "plan.note";
const KEPT_MS = 600_000;

export interface Note {
  subject: string;
  text: string;
  time_ns: string;
}

/** Whom a note is about: its first two words, or all of it. */
export function subjectOf(text: string): string {
  return /^(?:vehicle|beacon) \d+/.exec(text)?.[0] ?? text;
}

/** Newest first. What a proposal has overtaken is left out. */
export function planNotes(events: EventRow[], proposals: Iterable<ProposalRow>, station_ms: number): Note[] {
  const overtaken = new Map<string, number>();
  for (const row of proposals) {
    for (const subject of [`vehicle ${row.vehicle_id}`, `beacon ${row.beacon_id}`]) {
      overtaken.set(subject, Math.max(overtaken.get(subject) ?? 0, milliseconds(row.created_ns)));
    }
  }
  const found = new Map<string, Note>();
  for (let at = events.length - 1; at >= 0; at -= 1) {
    const event = events[at];
    if (event === undefined || event.code !== PLAN_NOTE) continue;
    const time_ms = milliseconds(event.time_ns);
    if (station_ms - time_ms > KEPT_MS) break;
    const subject = subjectOf(event.text);
    if (found.has(subject)) continue;
    // A subject with an older note only must not come back when its newest is overtaken.
    found.set(subject, { subject, text: (overtaken.get(subject) ?? 0) >= time_ms ? "" : readable(event.text), time_ns: event.time_ns });
  }
  return [...found.values()].filter(({ text }) => text !== "");
}

/** Long ids as everywhere on the page: by their last digits. */
export const readable = (text: string): string => text.replace(/\b\d{9,20}\b/g, shortId);

export interface Line {
  event: EventRow;
  /** How many notes of the same subject this line stands for. */
  times: number;
}

/** The log with the planner's repeated notes on one line each: the newest of every subject. */
export function collapsed(events: EventRow[]): Line[] {
  const lines: Line[] = [];
  const known = new Map<string, Line>();
  for (let at = events.length - 1; at >= 0; at -= 1) {
    const event = events[at];
    if (event === undefined) continue;
    const subject = event.code === PLAN_NOTE ? subjectOf(event.text) : "";
    const before = subject === "" ? undefined : known.get(subject);
    if (before !== undefined) {
      before.times += 1;
      continue;
    }
    const line = { event, times: 1 };
    if (subject !== "") known.set(subject, line);
    lines.push(line);
  }
  return lines;
}
