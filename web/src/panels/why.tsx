// What stands behind an estimate: each vehicle's part in it, how the radius came down, and the
// operator's word that two ids are one phone.
import { useState } from "preact/hooks";
import { joinBeacons } from "../actions";
import { placesOf } from "../map/places";
import { age, metres, shortId, unbroken } from "../units";
import type { HistoryPoint, TargetRow } from "../wire";
import { ageOf, isReplay, type Context } from "./context";
import { curveOf } from "./curve";
import { lastKnownText, reasonsOf } from "./reasons";

const [WIDTH, HEIGHT] = [300, 64];

function Radius({ context, row }: { context: Context; row: TargetRow }) {
  context.fetched.wantHistory(row.beacon_id);
  const fetched = context.fetched.histories.get(row.beacon_id) ?? [];
  const place = row.position;
  // The newest belief is in the stream; the curve ends with it.
  const now: HistoryPoint[] = place && fetched.length > 0 ? [{ time_ns: row.time_ns, radius_90_m: row.radius_90_m, windows: row.windows, links: row.links, ...place }] : [];
  const past = fetched.filter((point) => BigInt(point.time_ns) < BigInt(row.time_ns));
  const curve = curveOf([...past, ...now], WIDTH, HEIGHT);
  if (curve === null) return null;
  return (
    <figure class="curve" data-testid={`curve-${row.beacon_id}`}>
      <figcaption>
        90 % radius: <strong>{metres(curve.first_m)} → {metres(curve.last_m)}</strong> in {age(curve.span_s)}
      </figcaption>
      <div class="plot">
        <svg viewBox={`0 0 ${WIDTH} ${HEIGHT}`} preserveAspectRatio="none" role="img" aria-label={`90 % radius from ${metres(curve.first_m)} to ${metres(curve.last_m)} in ${age(curve.span_s)}`}>
          {curve.lines.map(({ radius_m, y }) => <line key={radius_m} x1="0" x2={WIDTH} y1={y} y2={y} />)}
          <path d={curve.path} />
        </svg>
        {curve.lines.map(({ radius_m, y }) => <span key={radius_m} class="tick" style={{ top: `${(100 * y) / HEIGHT}%` }}>{metres(radius_m)}</span>)}
      </div>
    </figure>
  );
}

function Reasons({ context, row }: { context: Context; row: TargetRow }) {
  const found = context.store.explanations.get(row.beacon_id);
  if (found === undefined || found.contributions.length === 0) return <p class="empty">Not worked out yet.</p>;
  return (
    <>
      <p class="detail">Each vehicle's share of what is known ({age(ageOf(context, found.time_ns))} ago)</p>
      <ul class="reasons" data-testid={`reasons-${row.beacon_id}`}>
        {reasonsOf(found.contributions).map((reason) => (
          <li key={reason.vehicle_id} data-testid={`reason-${row.beacon_id}-${reason.vehicle_id}`}>
            <div class="reason-head">
              <strong class="nowrap">Vehicle {reason.vehicle_id}</strong>
              <span class="bar" aria-hidden="true"><i style={{ width: `${Math.max(1, 100 * reason.weight)}%` }} /></span>
              <span class="number">{reason.share}</span>
            </div>
            <p>
              {reason.remarks.map(({ text, odd }, index) => <span key={text} class={odd ? "odd" : ""}>{index > 0 ? " · " : ""}{odd && "▲ "}{unbroken(text)}</span>)}
              <span class="note"> · {unbroken(reason.windows)}</span>
            </p>
          </li>
        ))}
      </ul>
    </>
  );
}

/** What was said before the search: it counts until the radio knows better. */
function LastKnown({ context, row }: { context: Context; row: TargetRow }) {
  const known = placesOf(context.store, row);
  if (known.length === 0) return null;
  return (
    <ul class="detail" data-testid={`last-known-${row.beacon_id}`}>
      {known.map((place, index) => <li key={index}>{unbroken(lastKnownText(place, row))}</li>)}
    </ul>
  );
}

/** Nothing is suggested: phones that change their address look like any two phones. */
function Join({ context, row }: { context: Context; row: TargetRow }) {
  const [into, setInto] = useState("");
  const [armed, setArmed] = useState(false);
  const others = [...context.store.targets.values()].filter((other) => other.beacon_id !== row.beacon_id && other.state !== "joined");
  if (others.length === 0 || isReplay(context)) return null;
  const chosen = others.find((other) => other.beacon_id === into);
  const join = (): void => {
    if (chosen) context.act(`Join beacon ${shortId(row.beacon_id)}`, joinBeacons(row.beacon_id, chosen.beacon_id));
    setArmed(false);
    setInto("");
  };
  return (
    <div class="join">
      <label>
        Same phone as{" "}
        <select data-testid={`join-into-${row.beacon_id}`} value={into} onChange={(event) => { setInto(event.currentTarget.value); setArmed(false); }}>
          <option value="">another beacon…</option>
          {others.map((other) => <option key={other.beacon_id} value={other.beacon_id}>{shortId(other.beacon_id)}</option>)}
        </select>
      </label>
      {chosen && !armed && <button type="button" class="plain" data-testid={`join-${row.beacon_id}`} onClick={() => setArmed(true)}>Join…</button>}
      {chosen && armed && (
        <>
          <p>What {shortId(row.beacon_id)} said and says will count for {shortId(chosen.beacon_id)}. It can be separated again.</p>
          <div class="buttons">
            <button type="button" class="go" data-testid={`join-confirm-${row.beacon_id}`} onClick={join}>Join {shortId(row.beacon_id)} into {shortId(chosen.beacon_id)}</button>
            <button type="button" class="plain" onClick={() => setArmed(false)}>Cancel</button>
          </div>
        </>
      )}
    </div>
  );
}

export function Why({ context, row }: { context: Context; row: TargetRow }) {
  return (
    <div class="why" data-testid={`why-${row.beacon_id}`}>
      {row.position && <Radius context={context} row={row} />}
      <LastKnown context={context} row={row} />
      {row.position && <Reasons context={context} row={row} />}
      {row.position && <a class="detail" href={`api/v1/targets/${encodeURIComponent(row.beacon_id)}/search-map/file`} download data-testid={`download-${row.beacon_id}`}>Search map for a GIS (ZIP)</a>}
      <Join context={context} row={row} />
    </div>
  );
}
