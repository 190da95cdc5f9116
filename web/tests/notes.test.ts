// The planner's notes: readable, current, and not a flood.
import { expect, test } from "vitest";
import { collapsed, planNotes, PLAN_NOTE, readable, subjectOf } from "../src/panels/notes";
import type { EventRow } from "../src/wire";
import { event, proposal } from "./builders";

const note = (number: number, text: string, time_s: number): EventRow => ({ ...event(number), code: PLAN_NOTE, text, time_ns: `${time_s}000000000` });

test("the newest note of each subject, newest first", () => {
  const events = [
    note(1, "beacon 7: not heard for 30 s, no vehicle is sent", 100),
    { ...event(2), text: "vehicle 1 found" },
    note(3, "vehicle 2 gets no proposal: 3.1 s without a pose", 103),
    note(4, "beacon 7: not heard for 35 s, no vehicle is sent", 105),
  ];
  expect(planNotes(events, [], 110_000).map(({ text }) => text)).toEqual([
    "beacon 7: not heard for 35 s, no vehicle is sent", "vehicle 2 gets no proposal: 3.1 s without a pose",
  ]);
  expect(planNotes(events, [], 800_000)).toEqual([]);
});

test("a proposal overtakes the notes before it, not those after", () => {
  const events = [note(1, "vehicle 2 gets no proposal: a", 100), note(2, "beacon 7: b", 100), note(3, "vehicle 2 gets no proposal: c", 120)];
  const shown = (created_s: number) => planNotes(events, [proposal("p", 2, "7", created_s)], 130_000).map(({ text }) => text);
  expect(shown(110)).toEqual(["vehicle 2 gets no proposal: c"]);
  expect(shown(125)).toEqual([]);
});

test("a note without a vehicle or beacon is its own subject", () => {
  expect(subjectOf("no fence is set: no vehicle can be sent anywhere")).toBe("no fence is set: no vehicle can be sent anywhere");
  expect(subjectOf("vehicle 12: no place near beacon 7: over the fence")).toBe("vehicle 12");
});

test("in the log repeated notes share a line, other events never do", () => {
  const events = [note(1, "beacon 7: 30 s", 1), event(2), note(3, "beacon 7: 35 s", 2), { ...event(4), text: "event 2" }, note(5, "beacon 7: 40 s", 3), note(6, "beacon 8: x", 3)];
  expect(collapsed(events).map(({ event: row, times }) => [row.number, times])).toEqual([[6, 1], [5, 3], [4, 1], [2, 1]]);
});

test("long ids are read by their last digits", () => {
  expect(readable("beacon 9007199254740993: known to within 3 m")).toBe("beacon …740993: known to within 3 m");
  expect(readable("beacon 7101 heard 12345 times")).toBe("beacon 7101 heard 12345 times");
});
