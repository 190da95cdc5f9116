import { expect, test } from "vitest";
import { StationClock } from "../src/clock";
import { Connection, GIVE_UP_AFTER_MS, STALE_AFTER_MS, type Socket, type Surroundings } from "../src/connection";
import { Store } from "../src/store";
import { delta, event, heartbeat, snapshot } from "./builders";

/** Time and sockets that the test owns. */
class World implements Surroundings {
  time_ms = 5_000_000;
  sockets: (Socket & { url: string; closed: boolean })[] = [];
  private timers: { at_ms: number; callback: () => void }[] = [];

  open(url: string): Socket {
    const socket = { url, closed: false, onopen: null, onmessage: null, onclose: null, close() { this.closed = true; } };
    this.sockets.push(socket);
    return socket;
  }
  now_ms = (): number => this.time_ms;
  later(callback: () => void, delay_ms: number): number {
    return this.timers.push({ at_ms: this.time_ms + delay_ms, callback });
  }
  random = (): number => 0.5;

  pass(duration_ms: number): void {
    const end_ms = this.time_ms + duration_ms;
    for (;;) {
      const due = this.timers.filter(({ at_ms }) => at_ms <= end_ms).sort((a, b) => a.at_ms - b.at_ms)[0];
      if (!due) break;
      this.timers.splice(this.timers.indexOf(due), 1);
      this.time_ms = due.at_ms;
      due.callback();
    }
    this.time_ms = end_ms;
  }
  get newest() {
    const socket = this.sockets.at(-1);
    if (!socket) throw new Error("no socket was opened");
    return socket;
  }
  say(message: unknown): void {
    this.newest.onmessage?.({ data: JSON.stringify(message) });
  }
}

function connected(): { world: World; store: Store; connection: Connection } {
  const world = new World();
  const store = new Store();
  const connection = new Connection("ws://station/stream", store, () => undefined, world);
  connection.start();
  world.say(snapshot(3));
  return { world, store, connection };
}

test("after a loss it comes back where it was", () => {
  const { world, connection } = connected();
  expect(connection.state).toBe("live");
  world.newest.onclose?.(undefined as never);
  expect(connection.state).toBe("lost");
  world.pass(600);
  expect(world.newest.url).toBe("ws://station/stream?since=e%3A3");
  world.say(delta(4, { events: [event(1)] }));
  expect(connection.state).toBe("live");
});

test("it waits longer each time, at most five seconds, and at once short again after success", () => {
  const { world } = connected();
  const waits: number[] = [];
  for (let attempt = 0; attempt < 6; attempt += 1) {
    const before = world.sockets.length;
    world.newest.onclose?.(undefined as never);
    const from_ms = world.time_ms;
    while (world.sockets.length === before) world.pass(100);
    waits.push(world.time_ms - from_ms);
  }
  expect(waits).toEqual([500, 1000, 2000, 4000, 5000, 5000]);
  world.say(heartbeat(3));
  world.newest.onclose?.(undefined as never);
  const before = world.sockets.length;
  world.pass(500);
  expect(world.sockets.length).toBe(before + 1);
});

test("silence is said first and then acted on", () => {
  const { world, connection } = connected();
  world.pass(STALE_AFTER_MS + 600);
  expect(connection.state).toBe("stale");
  expect(connection.silence_s).toBeGreaterThanOrEqual(3);
  const silent = world.newest;
  world.pass(GIVE_UP_AFTER_MS);
  expect(silent.closed).toBe(true);
  expect(connection.state).toBe("lost");
  expect(world.sockets.length).toBeGreaterThan(1);
});

test("a silent socket is left at the same pace for ever, not ever faster", () => {
  const { world } = connected();
  world.pass(120_000);
  expect(world.sockets.length).toBeGreaterThan(6);
  expect(world.sockets.length).toBeLessThan(16);
});

test("a gap asks for the whole picture", () => {
  const { world, connection } = connected();
  world.say(delta(9));
  expect(connection.state).toBe("lost");
  world.pass(600);
  expect(world.newest.url).toBe("ws://station/stream");
});

test("an unreadable stream is said and does not stop the page", () => {
  const { world, connection } = connected();
  world.newest.onmessage?.({ data: "{" });
  expect(connection.fault).not.toBe("");
  world.pass(600);
  world.say(snapshot(5));
  expect(connection.fault).toBe("");
  expect(connection.state).toBe("live");
});

test("a late message of an abandoned socket changes nothing", () => {
  const { world, store } = connected();
  const old = world.newest;
  old.onclose?.(undefined as never);
  world.pass(600);
  old.onmessage?.({ data: JSON.stringify(delta(4, { events: [event(1)] })) });
  expect(store.events).toHaveLength(0);
});

test("ages are counted by the station's clock, however far the laptop's is off", () => {
  let now_ms = 90_000;
  const clock = new StationClock(() => now_ms);
  // The station is at 60 s; messages take 5 to 50 ms.
  for (const [at_ms, delay_ms] of [[60_000, 50], [61_000, 5], [62_000, 30]] as const) {
    now_ms = at_ms + 30_000 + delay_ms;
    clock.observe(at_ms);
  }
  expect(clock.offset_ms).toBe(30_005);
  now_ms = 100_005;
  expect(clock.station_ms()).toBe(70_000);
});
