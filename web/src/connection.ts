// The websocket to the station: reconnects with back-off, resumes where it was, and says
// when what is shown is old. Time, sockets and chance come in, so that tests own them.
import { StationClock } from "./clock";
import type { Store, StreamMessage } from "./store";
import { milliseconds } from "./units";

export type ConnectionState = "connecting" | "live" | "stale" | "lost";

/** Heartbeats come every second: three missing is worth a word. */
export const STALE_AFTER_MS = 3_000;
/** A socket silent for so long is dead even if nobody said so. */
export const GIVE_UP_AFTER_MS = 8_000;
const BACKOFF_FIRST_MS = 500;
const BACKOFF_LAST_MS = 5_000;

export interface Socket {
  onopen: ((event: never) => void) | null;
  onmessage: ((event: { data: unknown }) => void) | null;
  onclose: ((event: never) => void) | null;
  close(): void;
}

export interface Surroundings {
  open(url: string): Socket;
  now_ms(): number;
  later(callback: () => void, delay_ms: number): number;
  random(): number;
}

export const browser: Surroundings = {
  open: (url) => new WebSocket(url) as unknown as Socket,
  now_ms: () => Date.now(),
  later: (callback, delay_ms) => window.setTimeout(callback, delay_ms),
  random: Math.random,
};

export class Connection {
  state: ConnectionState = "connecting";
  fault = "";
  readonly clock: StationClock;
  private socket: Socket | null = null;
  private attempts = 0;
  private heard_ms = 0;
  /** Last sign of life of the present socket: its opening or a message. */
  private sign_ms = 0;
  private everHeard = false;

  constructor(
    private readonly url: string,
    private readonly store: Store,
    private readonly changed: () => void,
    private readonly around: Surroundings = browser,
  ) {
    this.clock = new StationClock(around.now_ms);
  }

  /** Age of what is shown, seconds; null before the first message. */
  get silence_s(): number | null {
    return this.everHeard ? (this.around.now_ms() - this.heard_ms) / 1000 : null;
  }

  start(): void {
    this.connect();
    const watch = (): void => {
      this.watch();
      this.around.later(watch, 500);
    };
    this.around.later(watch, 500);
  }

  private connect(): void {
    const since = this.store.epoch === "" ? "" : `?since=${encodeURIComponent(`${this.store.epoch}:${this.store.seq}`)}`;
    const socket = this.around.open(this.url + since);
    this.socket = socket;
    this.sign_ms = this.around.now_ms();
    socket.onmessage = (event) => {
      if (this.socket === socket) this.take(String(event.data));
    };
    socket.onclose = () => {
      if (this.socket === socket) this.retry();
    };
  }

  private take(text: string): void {
    let outcome: string;
    try {
      const message = JSON.parse(text) as StreamMessage;
      if (message.type === "snapshot" && message.epoch !== this.store.epoch) this.clock.reset();
      this.clock.observe(milliseconds(message.server_time_ns));
      outcome = this.store.apply(message);
      this.fault = "";
    } catch (error) {
      this.fault = error instanceof Error ? error.message : String(error);
      outcome = "gap";
    }
    this.heard_ms = this.sign_ms = this.around.now_ms();
    this.everHeard = true;
    this.attempts = 0;
    if (outcome === "gap") {
      // Something is missing: the whole picture again.
      this.store.epoch = "";
      this.drop();
      return;
    }
    this.state = "live";
    this.changed();
  }

  private drop(): void {
    const socket = this.socket;
    this.retry();
    socket?.close();
  }

  private retry(): void {
    this.socket = null;
    this.state = this.everHeard ? "lost" : "connecting";
    const delay_ms = Math.min(BACKOFF_LAST_MS, BACKOFF_FIRST_MS * 2 ** this.attempts) * (0.75 + this.around.random() / 2);
    this.attempts += 1;
    this.around.later(() => this.connect(), delay_ms);
    this.changed();
  }

  private watch(): void {
    const silence_ms = this.around.now_ms() - this.sign_ms;
    if (this.socket !== null && silence_ms > GIVE_UP_AFTER_MS) {
      this.drop();
    } else if (this.state === "live" && silence_ms > STALE_AFTER_MS) {
      this.state = "stale";
      this.changed();
    }
  }
}
