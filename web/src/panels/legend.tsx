// What the colours and dashes on the map mean, and that there is no base map.
import { places } from "../map/places";
import { CLASSES, wanted } from "../map/searchmap";
import type { MapView } from "../map/index";
import { age, metres } from "../units";
import { ageOf, type Context } from "./context";

interface Props {
  context: Context;
  spacing_m: number;
  view: MapView | null;
  searchMap: boolean;
  setSearchMap(shown: boolean): void;
}

/** How old the oldest of the maps is that are drawn; what is missing where there is none. */
function mapAge(context: Context): string {
  const maps = wanted(context.store, context.selected).flatMap((beacon_id) => context.fetched.maps.get(beacon_id) ?? []);
  if (maps.length === 0) return "none yet";
  return `${age(Math.max(...maps.map((found) => ageOf(context, found.time_ns) ?? 0)))} old`;
}

function Shares({ context }: { context: Context }) {
  return (
    <>
      <p>Search map, % of the belief <span class="muted nowrap" data-testid="search-map-age">{mapAge(context)}</span></p>
      <div class="shares classes" aria-label="Squares that hold so many percent of the belief, the likeliest first">
        {CLASSES.map((limit, index) => <i key={limit} class={`search${index}`}>{Math.round(limit * 100)}</i>)}
      </div>
      <div class="ramp-text"><span>search first</span><span>search last</span></div>
    </>
  );
}

export function Legend({ context, spacing_m, view, searchMap, setSearchMap }: Props) {
  return (
    <>
      <div class="map-badge" data-testid="no-base-map">No base map · grid {metres(spacing_m)}</div>
      <div class="map-buttons">
        <button type="button" class={searchMap ? "primary" : "plain"} data-testid="search-map" aria-pressed={searchMap} title="Colours every square by how soon to search it" onClick={() => setSearchMap(!searchMap)}>Search map</button>
        <button type="button" class="plain map-centre" data-testid="centre" title="Shows vehicles, beacons and the search area, and follows them" onClick={() => view?.centre()}>Centre</button>
      </div>
      <details class="legend" data-testid="legend" open={window.innerWidth > 1100}>
        <summary>Legend</summary>
        {searchMap ? (
          <Shares context={context} />
        ) : (
          <>
            <p>A beacon lies within</p>
            <div class="shares" aria-label="50 %, 90 % or 95 % of the belief, the darkest first"><i class="share50">50 %</i><i class="share90">90 %</i><i class="share95">95 %</i></div>
          </>
        )}
        <p>Radio links</p>
        <div class="ramp" aria-hidden="true" />
        <div class="ramp-text"><span>no line of sight</span><span>line of sight</span></div>
        <ul>
          <li><i class="key dashed" />unclassified</li>
          <li><i class="key fence" />fence</li>
          <li><i class="key vehicle">2</i>vehicle 2</li>
          <li><i class="key offer">2</i>proposal</li>
          {places(context.store).length > 0 && <li data-testid="legend-last-known"><i class="key place" />last known</li>}
        </ul>
      </details>
    </>
  );
}
