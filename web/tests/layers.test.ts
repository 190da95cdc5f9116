// What the layers make of the picture.
import { expect, test } from "vitest";
import { shifted } from "../src/map/geometry";
import { links } from "../src/map/links";
import { lastKnown as places, middleOf, placesOf } from "../src/map/places";
import { regions as layer, regionsOf } from "../src/map/regions";
import { Store } from "../src/store";
import { distance_m } from "../src/units";
import type { Rows } from "../src/wire";
import { delta, lastKnown, link, mission, regions, rows, snapshot, target, vehicle } from "./builders";

const view = (selected = "") => ({
  bounds: { west: 9, east: 11, south: 0, north: 1 }, origin: { latitude_deg: 0.5, longitude_deg: 10, altitude_amsl_m: 0 }, width_px: 900, selected,
});

function storeOf(changes: Partial<Rows>): Store {
  const store = new Store();
  store.apply(snapshot(1, { rows: rows(changes) }));
  return store;
}

const drawn = (store: Store, selected = "") => layer.data(store, view(selected)).features.map(({ properties }) => properties?.["what"] as string);

test("regions are drawn where there are some, the circle and the ellipse where there are none", () => {
  expect(drawn(storeOf({ targets: [target("7")], regions: [regions("7")] }))).toEqual(["50", "90", "95"]);
  expect(drawn(storeOf({ targets: [target("7")] }))).toEqual(["circle", "ellipse"]);
  expect(drawn(storeOf({ targets: [{ ...target("7"), state: "waiting", position: null }], regions: [regions("7")] }))).toEqual([]);
});

test("regions of a belief long gone give way to the circle", () => {
  const row = target("7", 200);
  expect(regionsOf(storeOf({ targets: [row], regions: [regions("7", 190)] }), row)).not.toBeNull();
  const store = storeOf({ targets: [row], regions: [regions("7", 180)] });
  expect(regionsOf(store, row)).toBeNull();
  expect(drawn(store)).toEqual(["circle", "ellipse"]);
});

test("regions stay between deltas and go when they are removed", () => {
  const store = storeOf({ targets: [target("7")], regions: [regions("7")] });
  const before = store.version("regions");
  store.apply(delta(2, { rows: rows({ targets: [target("7", 101)] }) }));
  expect([store.regions.size, store.version("regions")]).toEqual([1, before]);
  store.apply(delta(3, { removed: [{ kind: "regions", key: "7", reason: "no estimate" }] }));
  expect([store.regions.size, store.version("regions")]).toEqual([0, before + 1]);
});

test("what is picked stays clear and the rest steps back", () => {
  const store = storeOf({
    vehicles: [vehicle(1), vehicle(2, 1e-3)], targets: [target("7"), target("8")], regions: [regions("7"), regions("8")],
    links: [link(1, "7"), link(2, "7"), link(1, "8")],
  });
  const dim = (selected: string) => links.data(store, view(selected)).features.map(({ properties }) => properties?.["dim"] as boolean);
  expect(dim("")).toEqual([false, false, false]);
  expect(dim("vehicle:2")).toEqual([true, false, true]);
  expect(dim("target:7")).toEqual([false, false, true]);
  expect(dim("link:1:8")).toEqual([true, true, false]);
  expect(dim("vehicle:9")).toEqual([false, false, false]);
  const areas = (selected: string) => layer.data(store, view(selected)).features.map(({ properties }) => properties?.["dim"] as boolean);
  expect(areas("link:1:8")).toEqual([true, true, true, false, false, false]);
  expect(areas("vehicle:1").some(Boolean)).toBe(false);
});

test("a last known place is a circle of its radius, with its name, its radius and its beacon", () => {
  const [longitude_deg, latitude_deg] = shifted(middleOf(lastKnown()), 300, -200);
  const known = lastKnown({ latitude_deg, longitude_deg, radius_m: 80, name: "hut", beacon_id: "7205759403792793601" });
  const [ring, label] = places.data(storeOf({ mission: mission({ last_known: [known] }) }), view()).features;
  const corners = ring?.geometry.type === "Polygon" ? (ring.geometry.coordinates[0] ?? []) : [];
  expect(corners.length).toBeGreaterThan(30);
  for (const [lon, lat] of corners) expect(distance_m(middleOf(known), { latitude_deg: lat ?? 0, longitude_deg: lon ?? 0, altitude_amsl_m: 0 })).toBeCloseTo(80, 3);
  expect(label?.properties?.["label"]).toBe("hut: last known, 80 m\nbeacon …793601");
  expect(ring?.properties?.["tip"]).toContain("hut\nwithin 80 m nine times in ten");
  expect(ring?.properties?.["select"]).toBe("target:7205759403792793601");
  const [, anyone] = places.data(storeOf({ mission: mission({ last_known: [lastKnown({ radius_m: 12_500 })] }) }), view()).features;
  expect(anyone?.properties?.["label"]).toBe("last known, 12.5 km");
  expect(anyone?.properties?.["tip"]).toContain("of any beacon");
  expect(places.data(storeOf({}), view()).features).toEqual([]);
});

test("a place belongs to its beacon, to the one it is joined into, or to all", () => {
  const last_known = [lastKnown({ beacon_id: "7" }), lastKnown({ beacon_id: "8" }), lastKnown()];
  const joined = { ...target("7"), joined_beacon_ids: ["8"] };
  const alone = target("9");
  const store = storeOf({ targets: [joined, alone], mission: mission({ last_known }) });
  expect(placesOf(store, joined)).toEqual(last_known);
  expect(placesOf(store, alone)).toEqual([last_known[2]]);
  const dim = (selected: string) => places.data(store, view(selected)).features.map(({ properties }) => properties?.["dim"] as boolean);
  expect(dim("")).toEqual([false, false, false, false, false, false]);
  expect(dim("target:7").some(Boolean)).toBe(false);
  expect(dim("link:3:9")).toEqual([true, true, true, true, false, false]);
  expect(dim("vehicle:3").some(Boolean)).toBe(false);
});
