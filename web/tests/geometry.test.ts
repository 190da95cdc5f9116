import { expect, test } from "vitest";
import { boundsOf, circle, ellipse90, ellipseRing, gridLines, gridSpacing_m } from "../src/map/geometry";
import { distance_m } from "../src/units";

const place = { latitude_deg: -35.3625, longitude_deg: 149.1654, altitude_amsl_m: 0 };
const at = ([longitude_deg, latitude_deg]: [number, number]) => ({ longitude_deg, latitude_deg, altitude_amsl_m: 0 });

test("a circle is closed and everywhere as far away as its radius", () => {
  const ring = circle(place, 30);
  expect(ring[0]).toEqual(ring.at(-1));
  for (const corner of ring) expect(distance_m(place, at(corner))).toBeCloseTo(30, 3);
});

test("the 90 % ellipse of a round covariance is a circle of 2.146 sigma", () => {
  const shape = ellipse90([4, 0, 0, 4, 0, 1]);
  expect(shape?.major_m).toBeCloseTo(2 * 2.145966, 5);
  expect(shape?.minor_m).toBeCloseTo(2 * 2.145966, 5);
});

test("its long axis lies where the covariance says", () => {
  // 3 m and 1 m sigma turned by 30 degrees.
  const [cos, sin] = [Math.cos(Math.PI / 6), Math.sin(Math.PI / 6)];
  const shape = ellipse90([9 * cos * cos + sin * sin, 8 * cos * sin, 0, 9 * sin * sin + cos * cos, 0, 1]);
  expect(shape?.angle_rad).toBeCloseTo(Math.PI / 6, 9);
  expect((shape?.major_m ?? 0) / (shape?.minor_m ?? 1)).toBeCloseTo(3, 9);
  const ring = ellipseRing(place, shape!);
  expect(Math.max(...ring.map((corner) => distance_m(place, at(corner))))).toBeCloseTo(shape!.major_m, 3);
});

test("what is no covariance gives no ellipse", () => {
  expect(ellipse90([1, 5, 0, 1, 0, 1])).toBeNull();
  expect(ellipse90([Number.NaN, 0, 0, 1, 0, 1])).toBeNull();
  expect(ellipse90([])).toBeNull();
});

test("grid spacing is 1, 2 or 5 times ten to some power and leaves room for labels", () => {
  for (const span_m of [7, 80, 333, 1000, 4321, 99_999]) {
    const spacing_m = gridSpacing_m(span_m, 6);
    expect(span_m / spacing_m).toBeLessThanOrEqual(6.0001);
    expect([1, 2, 5]).toContain(Number(spacing_m.toExponential().split("e")[0]));
  }
});

test("grid lines pass whole metres from the origin, however far the view is moved", () => {
  const bounds = { west: 149.1654, east: 149.1754, south: -35.3725, north: -35.3625 };
  const lines = gridLines(place, bounds, 100);
  expect(lines.filter(({ axis }) => axis === "east").map(({ value_m }) => value_m)).toEqual([0, 100, 200, 300, 400, 500, 600, 700, 800, 900]);
  expect(lines.filter(({ axis }) => axis === "north").every(({ value_m }) => value_m <= 0 && value_m % 100 === 0)).toBe(true);
  expect(gridLines(place, { west: -180, east: 180, south: -80, north: 80 }, 1).length).toBeLessThanOrEqual(200);
});

test("bounds of nothing are nothing", () => {
  expect(boundsOf([])).toBeNull();
  expect(boundsOf([[1, 2], [-3, 4]])).toEqual({ west: -3, east: 1, south: 2, north: 4 });
});
