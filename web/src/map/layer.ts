// What every layer of the map is: a source of GeoJSON made from the store, and how it is drawn.
import type { Feature, FeatureCollection, Geometry } from "geojson";
import type { GeoJSONSourceSpecification, LayerSpecification } from "maplibre-gl";
import type { Store, Table } from "../store";
import type { Palette } from "../themes/palette";
import type { Bounds } from "./geometry";
import type { Place } from "../wire";

export interface View {
  bounds: Bounds;
  origin: Place;
  /** Width of the map on the screen. */
  width_px: number;
  /** What the operator picked: `vehicle:3`, `target:…`, `link:…`, or nothing. */
  selected: string;
}

export interface MapLayer {
  /** Id of the source; the ids of the drawn layers begin with it. */
  id: string;
  /** Redrawn when one of these changed. */
  tables: Table[];
  /** Also redrawn when the view moved. */
  followsView?: boolean;
  /** Also redrawn when another thing was picked. */
  followsSelection?: boolean;
  /** Options of its source. */
  source?: Partial<GeoJSONSourceSpecification>;
  draw(palette: Palette): LayerSpecification[];
  data(store: Store, view: View): FeatureCollection;
  /** Drawn layers that answer to the pointer; their features carry `tip` and `select`. */
  pointable?: string[];
}

export const FONT = ["Open Sans Regular"];
/** The weight is read off the name; the letters are the browser's own. */
export const BOLD = ["Open Sans Bold"];

export function collection(features: Feature[]): FeatureCollection {
  return { type: "FeatureCollection", features };
}

export function feature(geometry: Geometry, properties: Record<string, unknown> = {}): Feature {
  return { type: "Feature", geometry, properties };
}

/** Whether that beacon, or one of its links, is what the operator picked. */
export const picks = (selected: string, beacon_id: string): boolean =>
  selected === `target:${beacon_id}` || (selected.startsWith("link:") && selected.endsWith(`:${beacon_id}`));

export const point = (place: Place): Geometry => ({ type: "Point", coordinates: [place.longitude_deg, place.latitude_deg] });
export const line = (...places: Place[]): Geometry => ({
  type: "LineString",
  coordinates: places.map((place) => [place.longitude_deg, place.latitude_deg]),
});
