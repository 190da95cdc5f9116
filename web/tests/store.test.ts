import { expect, test } from "vitest";
import { Store } from "../src/store";
import { delta, event, explanation, heartbeat, link, rows, snapshot, vehicle } from "./builders";

test("a delta that follows is taken, one that leaves a gap is not", () => {
  const store = new Store();
  store.apply(snapshot(4));
  expect(store.apply(delta(5, { rows: rows({ vehicles: [vehicle(1)] }) }))).toBe("ok");
  expect(store.apply(delta(7, { rows: rows({ vehicles: [vehicle(2)] }) }))).toBe("gap");
  expect([...store.vehicles.keys()]).toEqual([1]);
  expect(store.seq).toBe(5);
});

test("a merged delta may begin before what is known, and one already known is not taken twice", () => {
  const store = new Store();
  store.apply(snapshot(4));
  expect(store.apply(delta(6, { previous_seq: 4, events: [event(1)] }))).toBe("ok");
  expect(store.apply(delta(6, { previous_seq: 4, events: [event(1)] }))).toBe("ok");
  expect(store.events).toHaveLength(1);
});

test("another epoch's delta and a heartbeat ahead of us mean that something is missing", () => {
  const store = new Store();
  store.apply(snapshot(4));
  expect(store.apply(delta(5, { epoch: "other" }))).toBe("gap");
  expect(store.apply(heartbeat(5))).toBe("gap");
  expect(store.apply(heartbeat(4))).toBe("ok");
});

test("why a belief is what it is comes, is renewed and goes with its beacon's estimate", () => {
  const store = new Store();
  store.apply(snapshot(4, { rows: rows({ explanations: [explanation("7", 1)] }) }));
  store.apply(delta(5, { rows: rows({ explanations: [explanation("7", 2), explanation("8", 1)] }) }));
  expect([...store.explanations.values()].map(({ beacon_id, sequence }) => `${beacon_id}/${sequence}`)).toEqual(["7/2", "8/1"]);
  const before = store.version("explanations");
  store.apply(delta(6, { removed: [{ kind: "explanation", key: "7", reason: "no estimate" }] }));
  expect([...store.explanations.keys()]).toEqual(["8"]);
  expect(store.version("explanations")).toBe(before + 1);
});

test("rows removed are gone, and removed before rows of the same delta", () => {
  const store = new Store();
  store.apply(snapshot(0, { rows: rows({ vehicles: [vehicle(1)], links: [link(1, "9"), link(2, "9")] }) }));
  store.apply(delta(1, {
    removed: [{ kind: "vehicle", key: "1", reason: "evicted" }, { kind: "link", key: "1:9", reason: "evicted" }, { kind: "link", key: "2:9", reason: "evicted" }],
    rows: rows({ links: [link(2, "9")] }),
  }));
  expect(store.vehicles.size).toBe(0);
  expect([...store.links.keys()]).toEqual(["2:9"]);
});

test("a snapshot replaces everything but the log of the same run", () => {
  const store = new Store();
  store.apply(snapshot(1, { rows: rows({ vehicles: [vehicle(1)] }), events: [event(1), event(2)] }));
  store.apply(snapshot(9, { events: [event(2), event(3)] }));
  expect(store.vehicles.size).toBe(0);
  expect(store.events.map(({ number }) => number)).toEqual([1, 2, 3]);
  store.apply(snapshot(0, { epoch: "next", events: [event(1)] }));
  expect(store.events.map(({ number }) => number)).toEqual([1]);
});

test("the log and the trails are bounded, and a hovering vehicle leaves no trail", () => {
  const store = new Store();
  store.apply(snapshot(0));
  for (let seq = 1; seq <= 700; seq += 1) store.apply(delta(seq, { events: [event(seq)], rows: rows({ vehicles: [vehicle(1, seq * 1e-4), vehicle(2, seq * 1e-9)] }) }));
  expect(store.events).toHaveLength(500);
  expect(store.events.at(-1)?.number).toBe(700);
  expect(store.trails.get(1)).toHaveLength(300);
  expect(store.trails.get(2)).toHaveLength(1);
});

test("only what changed gets a new version", () => {
  const store = new Store();
  store.apply(snapshot(0));
  const before = store.version("links");
  store.apply(delta(1, { rows: rows({ vehicles: [vehicle(1)] }) }));
  expect(store.version("links")).toBe(before);
  expect(store.version("vehicles")).toBeGreaterThan(before);
});

test("another schema is refused aloud", () => {
  expect(() => new Store().apply({ ...snapshot(0), schema_version: 2 as never })).toThrow(/reload/);
});
