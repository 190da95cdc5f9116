// What the stream is too narrow for and a page asks for when somebody looks: search maps and
// histories. Rule: what was fetched stays when the station is gone, with its own time; a request
// that fails changes nothing.
import type { HistoryPoint, SearchMap, TargetHistory } from "./wire";

/** Between two requests for the same thing: maps are drawn every two seconds, a curve moves slowly. */
const MAP_AGAIN_MS = 2_000;
const HISTORY_AGAIN_MS = 10_000;
const TIMEOUT_MS = 5_000;
const HISTORY_POINTS = 160;

export type Get = (path: string) => Promise<unknown>;

const get: Get = async (path) => {
  const response = await fetch(path, { signal: AbortSignal.timeout(TIMEOUT_MS) });
  if (!response.ok) throw new Error(String(response.status));
  return response.json();
};

export class Fetched {
  readonly maps = new Map<string, SearchMap>();
  readonly histories = new Map<string, HistoryPoint[]>();
  /** Grows with every map that came: the layer is drawn again. */
  version = 0;
  private readonly asked_ms = new Map<string, number>();
  private readonly busy = new Set<string>();

  constructor(
    private readonly changed: () => void,
    private readonly now_ms: () => number = () => performance.now(),
    private readonly getJson: Get = get,
  ) {}

  /** Asks for the search map of a beacon when a newer one than ours was drawn at `drawn_ns`. */
  wantMap(beacon_id: string, drawn_ns: string): void {
    if (this.maps.get(beacon_id)?.time_ns === drawn_ns) return;
    this.ask(`map:${beacon_id}`, `api/v1/targets/${encodeURIComponent(beacon_id)}/search-map`, MAP_AGAIN_MS, (answer) => {
      this.maps.set(beacon_id, answer as SearchMap);
      this.version += 1;
    });
  }

  /** Asks for a beacon's past, now and then while it is wanted. */
  wantHistory(beacon_id: string): void {
    const path = `api/v1/targets/${encodeURIComponent(beacon_id)}/history?limit=${HISTORY_POINTS}`;
    this.ask(`history:${beacon_id}`, path, HISTORY_AGAIN_MS, (answer) => {
      this.histories.set(beacon_id, (answer as TargetHistory).points);
    });
  }

  /** Another run of the station: its beacons are not the ones that were fetched. */
  forget(): void {
    this.maps.clear();
    this.histories.clear();
    this.asked_ms.clear();
    this.version += 1;
  }

  private ask(name: string, path: string, again_ms: number, take: (answer: unknown) => void): void {
    const now = this.now_ms();
    if (this.busy.has(name) || now - (this.asked_ms.get(name) ?? -Infinity) < again_ms) return;
    this.asked_ms.set(name, now);
    this.busy.add(name);
    this.getJson(path)
      .then((answer) => {
        take(answer);
        this.changed();
      })
      .catch(() => undefined)
      .finally(() => this.busy.delete(name));
  }
}
