// The search map: squares coloured by how soon to search them. A square of the "50 %" colour is
// one of those that, the likeliest first, hold 50 % of the belief.
import type { CanvasSource, Map as MapLibre } from "maplibre-gl";
import type { Fetched } from "../fetched";
import type { Store } from "../store";
import { palettes, type ThemeName } from "../themes/palette";
import { milliseconds } from "../units";
import type { SearchMap } from "../wire";
import { picks } from "./layer";

/** Upper ends of the classes; beyond the last nothing is drawn. */
export const CLASSES = [0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99] as const;
/** Rasters drawn at one time; with more beacons the operator picks one. */
const SHOWN = 6;
/** What else tells where to search, hidden under the map; the outlines stay. */
const FILLS = ["regions-95", "regions-90", "regions-50", "regions-circle"];
const BELOW = "regions-90-line";

export const classOf = (containment: number): number => CLASSES.findIndex((limit) => containment <= limit);

/** Red, green, blue, opacity of each square, row by row from the north-west. */
export function pixels(found: SearchMap, colours: readonly string[]): Uint8ClampedArray {
  const rgb = colours.map((colour) => [1, 3, 5].map((at) => Number.parseInt(colour.slice(at, at + 2), 16)));
  const result = new Uint8ClampedArray(4 * found.rows * found.columns);
  found.containment.forEach((containment, index) => {
    const colour = rgb[classOf(containment)];
    // Beyond the last class; a square without any belief has containment 1.
    if (colour === undefined) return;
    result.set([...colour, 255], 4 * index);
  });
  return result;
}

/** Whose maps to draw: the picked beacon's alone, else those of the beacons updated last. */
export function wanted(store: Store, selected: string): string[] {
  const located = [...store.regions.values()].filter((row) => store.targets.get(row.beacon_id)?.position);
  const picked = located.filter(({ beacon_id }) => picks(selected, beacon_id));
  if (picked.length > 0) return picked.map((row) => row.beacon_id);
  return located
    .sort((a, b) => milliseconds(b.time_ns) - milliseconds(a.time_ns))
    .slice(0, SHOWN)
    .map((row) => row.beacon_id);
}

export class SearchMapLayer {
  shown = false;
  private readonly canvases = new Map<string, HTMLCanvasElement>();
  private drawn = "";

  constructor(
    private readonly map: MapLibre,
    private readonly store: Store,
    private readonly fetched: Fetched,
  ) {}

  /** The style was made anew: our sources went with it. */
  reset(): void {
    this.canvases.clear();
    this.drawn = "";
  }

  update(selected: string, theme: ThemeName): void {
    const ids = this.shown ? wanted(this.store, selected) : [];
    for (const beacon_id of ids) {
      const row = this.store.regions.get(beacon_id);
      if (row) this.fetched.wantMap(beacon_id, row.time_ns);
    }
    const maps = ids.flatMap((beacon_id) => this.fetched.maps.get(beacon_id) ?? []);
    const stamp = `${this.shown}/${theme}/${maps.map((found) => `${found.beacon_id}:${found.time_ns}`).join(",")}`;
    if (stamp === this.drawn) return;
    this.drawn = stamp;
    for (const layer of FILLS) this.map.setLayoutProperty(layer, "visibility", maps.length > 0 ? "none" : "visible");
    for (const beacon_id of [...this.canvases.keys()]) {
      if (!maps.some((found) => found.beacon_id === beacon_id)) this.remove(beacon_id);
    }
    for (const found of maps) this.draw(found, theme);
  }

  private remove(beacon_id: string): void {
    const id = `search-map-${beacon_id}`;
    if (this.map.getLayer(id)) this.map.removeLayer(id);
    if (this.map.getSource(id)) this.map.removeSource(id);
    this.canvases.delete(beacon_id);
  }

  private draw(found: SearchMap, theme: ThemeName): void {
    const id = `search-map-${found.beacon_id}`;
    const canvas = this.canvases.get(found.beacon_id) ?? document.createElement("canvas");
    if (canvas.width !== found.columns || canvas.height !== found.rows) [canvas.width, canvas.height] = [found.columns, found.rows];
    const image = new ImageData(found.columns, found.rows);
    image.data.set(pixels(found, palettes[theme].search));
    canvas.getContext("2d")?.putImageData(image, 0, 0);
    const coordinates = found.corners_deg as [[number, number], [number, number], [number, number], [number, number]];
    const source = this.map.getSource(id) as CanvasSource | undefined;
    if (source) {
      source.setCoordinates(coordinates);
      // Takes the canvas over once; a source that animates would redraw the map all the time.
      source.play();
      source.pause();
      return;
    }
    this.canvases.set(found.beacon_id, canvas);
    this.map.addSource(id, { type: "canvas", canvas, coordinates, animate: false });
    this.map.addLayer(
      { id, type: "raster", source: id, paint: { "raster-opacity": 0.85, "raster-resampling": "nearest", "raster-fade-duration": 0 } },
      BELOW,
    );
  }
}
