// The life of a command in the operator's words.
import type { CommandRow } from "../wire";

export type Phase = CommandRow["phase"];

export const STEPS: { phase: Phase; text: string }[] = [
  { phase: "sent", text: "sent" },
  { phase: "accepted", text: "accepted" },
  { phase: "flying", text: "flying" },
  { phase: "arrived", text: "arrived" },
];
export const HOLD_STEPS: { phase: Phase; text: string }[] = [
  { phase: "sent", text: "sent" },
  { phase: "accepted", text: "accepted" },
  { phase: "holding", text: "holding" },
];

const ENDED_BADLY: Record<string, string> = {
  refused: "refused",
  timed_out: "no answer",
  revoked: "stopped by a hold",
  superseded: "replaced by a newer command",
};

export const failure = (phase: Phase): string | null => ENDED_BADLY[phase] ?? null;
export const isOver = (phase: Phase): boolean => phase === "arrived" || phase === "holding" || phase in ENDED_BADLY;

/** How many steps of `steps` the phase has reached; a gated command has reached none. */
export function reached(phase: Phase, steps: { phase: Phase }[]): number {
  return steps.findIndex((step) => step.phase === phase) + 1;
}

const KEEP_DONE_MS = 60_000;
const KEEP_FAILED_MS = 300_000;

/** Commands worth showing: under way, or ended a short while ago; the newest of each vehicle. */
export function current(commands: Iterable<CommandRow>, station_ms: number, milliseconds: (time_ns: string) => number): CommandRow[] {
  const newest = new Map<number, CommandRow>();
  for (const row of commands) {
    const known = newest.get(row.vehicle_id);
    if (!known || BigInt(row.time_ns) >= BigInt(known.time_ns)) newest.set(row.vehicle_id, row);
  }
  return [...newest.values()]
    .filter((row) => {
      if (!isOver(row.phase)) return true;
      const keep_ms = row.phase === "refused" || row.phase === "timed_out" ? KEEP_FAILED_MS : KEEP_DONE_MS;
      return station_ms - milliseconds(row.time_ns) < keep_ms;
    })
    .sort((a, b) => a.vehicle_id - b.vehicle_id);
}
