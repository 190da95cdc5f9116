// What the layers make of the picture.
import { expect, test } from "vitest";
import { links } from "../src/map/links";
import { regions as layer, regionsOf } from "../src/map/regions";
import { Store } from "../src/store";
import type { Rows } from "../src/wire";
import { delta, link, regions, rows, snapshot, target, vehicle } from "./builders";

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
