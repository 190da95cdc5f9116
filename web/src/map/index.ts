// The map: composes the layers, keeps the view, answers to the pointer.
import { Map as MapLibre, NavigationControl, Popup, ScaleControl, setWorkerUrl, type GeoJSONSource, type Point, type StyleSpecification } from "maplibre-gl";
import workerUrl from "maplibre-gl/dist/maplibre-gl-worker.mjs?worker&url";
import "maplibre-gl/dist/maplibre-gl.css";
import type { Fetched } from "../fetched";
import type { Store, Table } from "../store";
import { palettes, type ThemeName } from "../themes/palette";
import type { Place } from "../wire";
import { boundsOf, circle, type Bounds } from "./geometry";
import { grid, spacingOf } from "./grid";
import { icon, iconRatio } from "./icons";
import { collection, type MapLayer } from "./layer";
import { links } from "./links";
import { mission } from "./mission";
import { lastKnown, middleOf, places } from "./places";
import { proposals } from "./proposals";
import { regions } from "./regions";
import { SearchMapLayer } from "./searchmap";
import { targets } from "./targets";
import { trails } from "./trails";
import { vehicles } from "./vehicles";

setWorkerUrl(workerUrl);

const LAYERS: MapLayer[] = [grid, mission, regions, lastKnown, trails, links, targets, proposals, vehicles];

const FIT_ZOOM_MAX = 18.5;
/** A search area so much wider than all that was found and flies is left out of the view. */
const WIDE = 4;
/** Shortest time between two changes of the view that nobody asked for. */
const FIT_AGAIN_MS = 3_000;

function style(theme: ThemeName): StyleSpecification {
  const palette = palettes[theme];
  return {
    version: 8,
    sources: Object.fromEntries(LAYERS.map(({ id, source }) => [id, { type: "geojson", data: collection([]), ...source }])),
    layers: [
      { id: "background", type: "background", paint: { "background-color": palette.background } },
      ...LAYERS.flatMap((layer) => layer.draw(palette)),
    ],
  };
}

export class MapView {
  private readonly map: MapLibre;
  private readonly popup = new Popup({ closeButton: false, closeOnClick: false, maxWidth: "320px", offset: 14 });
  private readonly drawn = new Map<string, string>();
  private readonly searchMap: SearchMapLayer;
  private ready = false;
  private fitted = false;
  private moves = 0;
  /** The operator chose the view: from then on it is theirs. */
  private touched = false;
  private fitted_ms = 0;
  private selected = "";
  private anchor: Place | null = null;
  private theme: ThemeName;

  constructor(
    container: HTMLElement,
    private readonly store: Store,
    theme: ThemeName,
    private readonly select: (key: string) => void,
    private readonly spacing: (spacing_m: number) => void,
    fetched: Fetched,
  ) {
    this.theme = theme;
    const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.map = new MapLibre({
      container, style: style(theme), center: [0, 0], zoom: 1, maxZoom: 22, attributionControl: false,
      dragRotate: false, pitchWithRotate: false, touchPitch: false, fadeDuration: still ? 0 : 100,
    });
    this.searchMap = new SearchMapLayer(this.map, store, fetched);
    this.map.touchZoomRotate.disableRotation();
    this.map.addControl(new NavigationControl({ showCompass: false }), "top-right");
    this.map.addControl(new ScaleControl({ unit: "metric", maxWidth: 140 }), "bottom-left");
    this.map.setMissingStyleImageResolver((id) => {
      const image = icon(id, palettes[this.theme]);
      if (image && !this.map.hasImage(id)) this.map.addImage(id, image, { pixelRatio: iconRatio });
    });
    this.map.on("load", () => {
      this.ready = true;
      container.dataset["ready"] = "true";
      this.update();
    });
    this.map.on("movestart", (event) => {
      if ("originalEvent" in event && event.originalEvent) this.touched = true;
    });
    this.map.on("moveend", () => {
      this.moves += 1;
      this.update();
    });
    this.point();
  }

  private point(): void {
    const pointable = LAYERS.flatMap((layer) => layer.pointable ?? []);
    const under = (at: Point) =>
      this.ready ? this.map.queryRenderedFeatures([[at.x - 6, at.y - 6], [at.x + 6, at.y + 6]], { layers: pointable })[0] : undefined;
    let pointer: Point | null = null;
    const tell = () => {
      const found = pointer && under(pointer);
      this.map.getCanvas().style.cursor = found ? "pointer" : "";
      if (!pointer || !found) {
        this.popup.remove();
        return;
      }
      const tip = document.createElement("div");
      tip.className = "map-tip";
      tip.textContent = String(found.properties["tip"] ?? "");
      this.popup.setLngLat(this.map.unproject(pointer)).setDOMContent(tip).addTo(this.map);
    };
    this.map.on("mousemove", (event) => {
      pointer = event.point;
      tell();
    });
    // What flies by a resting pointer, and what is new of the thing below it.
    this.map.on("idle", tell);
    this.map.on("mouseout", () => {
      pointer = null;
      tell();
    });
    this.map.on("click", (event) => {
      const key: unknown = under(event.point)?.properties["select"];
      this.select(typeof key === "string" ? key : "");
    });
  }

  /** Draws what changed since the last call. */
  update(): void {
    if (!this.ready) return;
    if (!this.fitted) this.fitted = this.fit(false);
    if (!this.fitted) return;
    this.keepInSight();
    const view = {
      selected: this.selected, bounds: this.bounds(), origin: this.origin(), width_px: this.map.getContainer().clientWidth };
    for (const layer of LAYERS) {
      const stamp = this.stamp(layer.tables) + (layer.followsView ? `/${this.moves}` : "") + (layer.followsSelection ? `/${this.selected}` : "");
      if (this.drawn.get(layer.id) === stamp) continue;
      this.drawn.set(layer.id, stamp);
      (this.map.getSource(layer.id) as GeoJSONSource | undefined)?.setData(layer.data(this.store, view));
    }
    this.searchMap.update(this.selected, this.theme);
    this.spacing(spacingOf(view));
  }

  /** Until the operator moves the map it follows: what flies out of the view widens it. */
  private keepInSight(): void {
    const content = this.content();
    if (this.touched || content === null || this.map.isMoving() || performance.now() - this.fitted_ms < FIT_AGAIN_MS) return;
    const seen = this.bounds();
    const outside = content.west < seen.west || content.east > seen.east || content.south < seen.south || content.north > seen.north;
    const share = Math.max((content.east - content.west) / (seen.east - seen.west), (content.north - content.south) / (seen.north - seen.south));
    if (outside || (share < 0.25 && this.map.getZoom() < FIT_ZOOM_MAX - 0.1)) this.fit();
  }

  /** Shows or hides the squares of the search map. */
  setSearchMap(shown: boolean): void {
    this.searchMap.shown = shown;
    this.update();
  }

  setSelected(key: string): void {
    this.selected = key;
    this.update();
  }

  private stamp(tables: Table[]): string {
    return tables.map((table) => this.store.version(table)).join(".");
  }

  setTheme(theme: ThemeName): void {
    if (theme === this.theme) return;
    this.theme = theme;
    this.ready = false;
    this.map.setStyle(style(theme), { diff: false });
    this.map.once("style.load", () => {
      this.ready = true;
      this.drawn.clear();
      this.searchMap.reset();
      this.update();
    });
  }

  /** Shows all that matters and gives the view back to the page; false when nothing has a place yet. */
  centre(): void {
    this.touched = false;
    this.fit();
  }

  /** Shows all that matters; false when nothing has a place yet. */
  fit(animate = true): boolean {
    const bounds = this.content();
    if (bounds === null) return false;
    this.fitted_ms = performance.now();
    const still = !animate || window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.map.fitBounds([[bounds.west, bounds.south], [bounds.east, bounds.north]], { padding: { top: 40, left: 60, right: 70, bottom: 64 }, maxZoom: FIT_ZOOM_MAX, animate: !still, duration: 500 });
    return true;
  }

  flyTo(place: Place): void {
    this.touched = true;
    this.map.easeTo({ center: [place.longitude_deg, place.latitude_deg], animate: !window.matchMedia("(prefers-reduced-motion: reduce)").matches });
  }

  resize(): void {
    this.map.resize();
  }

  private content(): Bounds | null {
    const store = this.store;
    const points: number[][] = [];
    for (const row of [...store.vehicles.values(), ...store.targets.values(), ...store.proposals.values()]) {
      if (row.position) points.push([row.position.longitude_deg, row.position.latitude_deg]);
    }
    const found = boundsOf(points);
    const area = [
      ...(store.mission?.search_area?.polygons_deg.flat(2) ?? []),
      ...places(store).flatMap((known) => circle(middleOf(known), known.radius_m, 4)),
    ];
    const whole = boundsOf(area);
    const located = [...store.targets.values()].some((row) => row.position !== null);
    const wide = located && found && whole && whole.north - whole.south > WIDE * (found.north - found.south) && whole.east - whole.west > WIDE * (found.east - found.west);
    if (!wide) points.push(...area);
    // The fence may be far wider than what happens inside: it counts only where nothing else does.
    if (points.length === 0) points.push(...(store.mission?.fence?.polygons_deg.flat(2) ?? []));
    return boundsOf(points);
  }

  private origin(): Place {
    const centre = this.map.getCenter();
    // Until the mission has an origin the grid starts where the view first was, and stays there.
    this.anchor ??= { latitude_deg: centre.lat, longitude_deg: centre.lng, altitude_amsl_m: 0 };
    return this.store.mission?.origin ?? this.anchor;
  }

  private bounds(): Bounds {
    const bounds = this.map.getBounds();
    return { west: bounds.getWest(), east: bounds.getEast(), south: bounds.getSouth(), north: bounds.getNorth() };
  }
}
