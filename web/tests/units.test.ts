import { expect, test } from "vitest";
import { age, clockTime, compass, coordinates, dbm, distance_m, heardAge, metres, milliseconds, percent, shortId, unbroken, uncertainty } from "../src/units";

const origin = { latitude_deg: -35.3625, longitude_deg: 149.1654, altitude_amsl_m: 584 };

test("every number carries its unit, and what is unknown is a dash", () => {
  expect(metres(84.4)).toBe("84 m");
  expect(metres(12_345)).toBe("12.3 km");
  expect(dbm(-71.6)).toBe("-72 dBm");
  expect(percent(0)).toBe("0 %");
  for (const text of [metres(null), metres(Number.NaN), dbm(null), percent(undefined), age(null)]) expect(text).toBe("–");
});

test("a number is never parted from its unit at the end of a line", () => {
  expect(unbroken("within 31 m: listen from 4 km away, 6.4 dB, 90 % in 2 min")).toBe("within 31\u00a0m: listen from 4\u00a0km away, 6.4\u00a0dB, 90\u00a0% in 2\u00a0min");
  expect(unbroken("beacon 7 may walk 3 more")).toBe("beacon 7 may walk 3 more");
});

test("ages grow from seconds to hours and never go below zero", () => {
  expect(age(-3)).toBe("0 s");
  expect(age(59.9)).toBe("59 s");
  expect(age(61)).toBe("1 min 01 s");
  expect(age(3_725)).toBe("1 h 02 min");
});

test("an uncertainty is a bound: it is rounded up, never away", () => {
  expect([0, 0.0002, 0.003, 0.0031, 0.9994].map(uncertainty)).toEqual(["± 0 ms", "± 1 ms", "± 3 ms", "± 4 ms", "± 1.0 s"]);
  expect([1, 1.21, 30].map(uncertainty)).toEqual(["± 1.0 s", "± 1.3 s", "± 30.0 s"]);
  for (const unknown of [null, undefined, Number.NaN]) expect(uncertainty(unknown)).toBe("–");
});

test("times beyond 2^53 keep their milliseconds", () => {
  expect(milliseconds("1795312345678901234")).toBe(1_795_312_345_678);
  expect(clockTime("1795312345678901234")).toMatch(/^\d\d:\d\d:\d\d$/);
});

test("distance and compass on the tangent plane", () => {
  const north = { ...origin, latitude_deg: origin.latitude_deg + 100 / 111_320 };
  const west = { ...origin, longitude_deg: origin.longitude_deg - 0.001 };
  expect(distance_m(origin, north)).toBeCloseTo(100, 6);
  expect(compass(origin, north)).toBe("N");
  expect(compass(origin, west)).toBe("W");
  expect(distance_m(origin, west)).toBeCloseTo(111.32 * Math.cos((35.3625 * Math.PI) / 180), 6);
});

test("coordinates are what other tools take", () => {
  expect(coordinates(origin)).toBe("-35.362500, 149.165400");
  expect(shortId("7205759403792793601")).toBe("…793601");
  expect(shortId("42")).toBe("42");
});

test("what was heard a moment ago is now, and steady", () => {
  expect([0, 1.2, 2.9].map(heardAge)).toEqual(["now", "now", "now"]);
  expect([heardAge(3), heardAge(75), heardAge(null)]).toEqual(["3 s", "1 min 15 s", "–"]);
});
