import { expect, test } from "vitest";
import { current, failure, isOver, reached, STEPS } from "../src/panels/phases";
import { milliseconds } from "../src/units";
import type { CommandRow } from "../src/wire";

const command = (command_id: string, vehicle_id: number, phase: CommandRow["phase"], time_s: number): CommandRow => ({
  command_id, vehicle_id, kind: "reposition", phase, time_ns: `${time_s}000000000`, detail: "", target: null, proposal_id: null, attempts: 1,
});

test("a command's phases light up in order", () => {
  expect(STEPS.map(({ phase }) => reached(phase, STEPS))).toEqual([1, 2, 3, 4]);
  expect(reached("gated", STEPS)).toBe(0);
});

test("the newest command of each vehicle is shown, ended ones for a while", () => {
  const commands = [command("a", 1, "arrived", 100), command("b", 1, "flying", 150), command("c", 2, "arrived", 100), command("d", 3, "refused", 100)];
  const shown = (now_s: number) => current(commands, now_s * 1000, milliseconds).map(({ command_id }) => command_id);
  expect(shown(150)).toEqual(["b", "c", "d"]);
  expect(shown(170)).toEqual(["b", "d"]);
  expect(shown(900)).toEqual(["b"]);
});

test("every way to fail has a word and is over", () => {
  for (const phase of ["refused", "timed_out", "revoked", "superseded"] as const) {
    expect(failure(phase)).not.toBeNull();
    expect(isOver(phase)).toBe(true);
  }
  expect(isOver("flying")).toBe(false);
});
