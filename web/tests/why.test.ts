// What stands behind an estimate, in words, as a curve and as squares.
import { expect, test } from "vitest";
import { Fetched } from "../src/fetched";
import { CLASSES, classOf, pixels, wanted } from "../src/map/searchmap";
import { curveOf } from "../src/panels/curve";
import { lastKnownText, reasonsOf } from "../src/panels/reasons";
import { Store } from "../src/store";
import { palettes } from "../src/themes/palette";
import type { ContributionRow, HistoryPoint, SearchMap } from "../src/wire";
import { lastKnown, regions, rows, snapshot, target } from "./builders";

const contribution = (changes: Partial<ContributionRow>): ContributionRow => ({
  vehicle_id: 1, weight: 0.5, area_factor: 2, windows: 40, redundant: 0, outliers: 0, power_residual_db: 6.4, power_score: 1.3,
  azimuth_residual_deg: null, azimuth_score: null, elevation_residual_deg: null, elevation_score: null, los_probability: 0.1, ...changes,
});

const said = (changes: Partial<ContributionRow>): string => {
  const reason = reasonsOf([contribution(changes)])[0];
  return `${reason?.share}: ${reason?.remarks.map(({ text, odd }) => (odd ? `!${text}` : text)).join("; ")} [${reason?.windows}]`;
};

test("a vehicle's part is said in whole percent, with its sign", () => {
  expect(said({ weight: 0.424 })).toBe("42 %: without it the area would be 2.0 × as large; hears it 6 dB stronger than the estimate explains; line of sight: 10 % likely [40 windows]");
  expect(said({ power_residual_db: -8.6, power_score: -2.2 })).toContain("!hears it 9 dB weaker than the estimate explains – unusual");
  expect(said({ power_score: 3.4 })).toContain("– does not fit");
  expect(said({ weight: 0.001, area_factor: 1.01 })).toMatch(/^under 1 %: adds little/);
  expect(said({ windows: 1, redundant: 3, outliers: 2 })).toContain("[1 window, 3 more from the same places, 2 doubtful, weighed down]");
});

test("what is to be looked at comes first", () => {
  expect(said({ power_score: 3.4 })).toMatch(/^50 %: !hears it 6 dB stronger than the estimate explains – does not fit; without it/);
});

test("what is within its spread is no news", () => {
  expect(said({ power_residual_db: 39.6, power_score: 0.98 })).toContain("its power fits the estimate (±40 dB)");
  expect(said({ power_residual_db: null, power_score: null })).not.toContain("power");
  expect(said({ power_residual_db: 0, power_score: 0 })).toContain("its power fits the estimate;");
});

test("one that contradicts the others says so first", () => {
  expect(said({ area_factor: 0.62 })).toMatch(/^50 %: !contradicts the others: without it the area would be 0.6 × as large/);
});

test("a bearing points to a side, and is only odd where there should be line of sight", () => {
  const turned = { azimuth_residual_deg: 11.2, azimuth_score: 3.5, elevation_residual_deg: -2.1, elevation_score: -1.2 };
  expect(said({ ...turned, los_probability: 0.9 })).toContain("!its bearing points 11° to the right of and 2.1° below the estimate – does not fit");
  expect(said({ ...turned, los_probability: 0.2 })).toContain("; its bearing counts little (a reflection);");
  expect(said({ ...turned, los_probability: null })).toContain("; its bearing points 11° to the right of and 2.1° below the estimate;");
  expect(said({ ...turned, azimuth_score: -0.4, elevation_score: 0.1, los_probability: 0.9 })).toContain("its bearing fits the estimate (±28°)");
  expect(said({ ...turned, azimuth_residual_deg: -4, azimuth_score: -1.4, elevation_score: 0.1, los_probability: 0.9 })).toContain("4.0° to the left of the estimate");
});

test("the most telling vehicle comes first", () => {
  const order = reasonsOf([contribution({ vehicle_id: 4, weight: 0.1 }), contribution({ vehicle_id: 2, weight: 0.6 }), contribution({ vehicle_id: 1, weight: 0.1 })]);
  expect(order.map(({ vehicle_id }) => vehicle_id)).toEqual([2, 1, 4]);
});

test("a last known place is told in metres, and where the estimate lies from it", () => {
  const row = target("7");
  const hut = lastKnown({ latitude_deg: 0.5 + 120 / 111_320, name: "hut", beacon_id: "7" });
  expect(lastKnownText(hut, row)).toBe("Last known: hut, within 80 m · the estimate is 120 m S of its middle");
  expect(lastKnownText({ ...hut, name: "", beacon_id: null }, { ...row, position: null })).toBe("Last known: within 80 m (any beacon)");
  expect(lastKnownText({ ...hut, beacon_id: "7205759403792793601" }, row)).toContain("within 80 m (of …793601) · ");
  expect(lastKnownText(lastKnown(), row)).toContain("the estimate is its middle");
});

const point = (time_s: number, radius_90_m: number | null): HistoryPoint => ({
  time_ns: `${time_s}000000000`, radius_90_m, latitude_deg: 0, longitude_deg: 0, altitude_amsl_m: 0, windows: 1, links: 1,
});

test("halving the radius is the same step anywhere on the curve", () => {
  const curve = curveOf([point(100, 200), point(110, 100), point(120, 50), point(130, null)], 300, 60);
  expect(curve).toMatchObject({ first_m: 200, last_m: 50, span_s: 20 });
  const ys = [...(curve?.path ?? "").matchAll(/[ML][\d.]+ ([\d.]+)/g)].map((found) => Number(found[1]));
  expect(ys).toHaveLength(3);
  expect((ys[1] ?? 0) - (ys[0] ?? 0)).toBeCloseTo((ys[2] ?? 0) - (ys[1] ?? 0), 0);
  expect(curve?.path.startsWith("M0.0 ")).toBe(true);
  expect(curve?.lines.map(({ radius_m }) => radius_m)).toEqual([50, 200]);
});

test("there is no curve of one point, or of none", () => {
  expect(curveOf([], 300, 60)).toBeNull();
  expect(curveOf([point(1, 5)], 300, 60)).toBeNull();
  expect(curveOf([point(1, null), point(2, null)], 300, 60)).toBeNull();
});

const map = (changes: Partial<SearchMap> = {}): SearchMap => ({
  schema_version: 1, server_time_ns: "1", beacon_id: "7", time_ns: "100000000000", rows: 1, columns: 4, cell_size_m: 2, west_m: 0, north_m: 0,
  origin_latitude_deg: 0, origin_longitude_deg: 0, north_west_latitude_deg: 0, north_west_longitude_deg: 0, south_east_latitude_deg: 0,
  south_east_longitude_deg: 0, corners_deg: [[0, 1], [1, 1], [1, 0], [0, 0]], probability: [0.5, 0.4, 0.1, 0], containment: [0.09, 0.9, 0.995, 1], ...changes,
});

test("a square has the colour of its class, and none where nothing is believed", () => {
  expect([0.05, 0.1, 0.11, 0.5, 0.95, 0.99].map(classOf)).toEqual([0, 0, 1, 2, 5, 6]);
  expect(classOf(0.991)).toBe(-1);
  for (const theme of ["light", "dark"] as const) {
    const colours = palettes[theme].search;
    expect(colours).toHaveLength(CLASSES.length);
    const drawn = pixels(map(), colours);
    expect([...drawn.slice(0, 3)].map((part) => part.toString(16).padStart(2, "0")).join("")).toBe(colours[0].slice(1));
    expect([3, 7, 11, 15].map((at) => drawn[at])).toEqual([255, 255, 0, 0]);
  }
});

test("the picked beacon's map is drawn alone", () => {
  const store = new Store();
  store.apply(snapshot(1, { rows: rows({ targets: [target("7"), target("8"), { ...target("9"), position: null, state: "waiting" }], regions: [regions("7", 100), regions("8", 200), regions("9", 300)] }) }));
  expect(wanted(store, "")).toEqual(["8", "7"]);
  expect(wanted(store, "target:7")).toEqual(["7"]);
  expect(wanted(store, "link:3:8")).toEqual(["8"]);
});

test("a map that is the newest is not asked for again", async () => {
  let now = 0;
  const asked: string[] = [];
  const fetched = new Fetched(() => undefined, () => now, async (path) => {
    asked.push(path);
    return map({ time_ns: "100" });
  });
  fetched.wantMap("7", "100");
  await new Promise((done) => setTimeout(done, 0));
  now = 60_000;
  fetched.wantMap("7", "100");
  await new Promise((done) => setTimeout(done, 0));
  expect(asked).toHaveLength(1);
});

test("a map is asked for when a newer one was drawn, and stays when the station is gone", async () => {
  let [now, gone] = [0, false];
  const asked: string[] = [];
  const fetched = new Fetched(() => undefined, () => now, async (path) => {
    asked.push(path);
    if (gone) throw new Error("gone");
    return map({ time_ns: `${asked.length}00` });
  });
  const settle = (): Promise<unknown> => new Promise((done) => setTimeout(done, 0));
  fetched.wantMap("7", "100");
  fetched.wantMap("7", "100");
  await settle();
  expect(asked).toEqual(["api/v1/targets/7/search-map"]);
  fetched.wantMap("7", "100");
  fetched.wantMap("7", "200");
  await settle();
  expect(asked).toHaveLength(1); // not before two seconds are over
  now = 2_000;
  fetched.wantMap("7", "200");
  await settle();
  expect([asked.length, fetched.maps.get("7")?.time_ns, fetched.version]).toEqual([2, "200", 2]);
  [now, gone] = [4_000, true];
  fetched.wantMap("7", "300");
  await settle();
  expect([asked.length, fetched.maps.get("7")?.time_ns]).toEqual([3, "200"]);
  fetched.forget();
  expect(fetched.maps.size).toBe(0);
});
