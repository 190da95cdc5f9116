// What every panel gets: the picture, the station's time, and ways to act.
import type { Connection } from "../connection";
import type { Fetched } from "../fetched";
import type { Store } from "../store";
import { milliseconds } from "../units";
import type { Place } from "../wire";
import type { Outcome } from "../actions";

export const REPLAY_REFUSAL = "this is a replay: it sends nothing";

/** Whether a recording is shown: there is nobody to hold or to send. */
export const isReplay = (context: Context): boolean => context.store.station?.source === "replay";

export interface Context {
  store: Store;
  connection: Connection;
  fetched: Fetched;
  /** Station time of this rendering, ms. */
  station_ms: number;
  selected: string;
  select(key: string): void;
  show(place: Place): void;
  /** Shows how an action ended, once it has. */
  act(what: string, outcome: Promise<Outcome>): void;
}

/** Seconds since a time of the station's. */
export function ageOf(context: Context, time_ns: string | null): number | null {
  return time_ns === null ? null : Math.max(0, (context.station_ms - milliseconds(time_ns)) / 1000);
}
