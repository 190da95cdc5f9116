// What the colours and dashes on the map mean, and that there is no base map.
import { metres } from "../units";
import type { MapView } from "../map/index";

export function Legend({ spacing_m, view }: { spacing_m: number; view: MapView | null }) {
  return (
    <>
      <div class="map-badge" data-testid="no-base-map">No base map · grid {metres(spacing_m)}</div>
      <button type="button" class="plain map-centre" data-testid="centre" title="Shows vehicles, beacons and the search area, and follows them" onClick={() => view?.centre()}>Centre</button>
      <details class="legend" data-testid="legend" open={window.innerWidth > 1100}>
        <summary>Legend</summary>
        <p>A beacon lies within</p>
        <div class="shares" aria-label="50 %, 90 % or 95 % of the belief, the darkest first"><i class="share50">50 %</i><i class="share90">90 %</i><i class="share95">95 %</i></div>
        <p>Radio links</p>
        <div class="ramp" aria-hidden="true" />
        <div class="ramp-text"><span>no line of sight</span><span>line of sight</span></div>
        <ul>
          <li><i class="key dashed" />unclassified</li>
          <li><i class="key fence" />fence</li>
          <li><i class="key vehicle">2</i>vehicle 2</li>
          <li><i class="key offer">2</i>proposal</li>
        </ul>
      </details>
    </>
  );
}
