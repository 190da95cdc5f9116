// Beacons: where, how sure, how old; or what is missing for a position.
import { useState } from "preact/hooks";
import { age, coordinates, heardAge, metres, probability, shortId } from "../units";
import type { Place, TargetRow } from "../wire";
import { separateBeacon } from "../actions";
import { ageOf, isReplay, type Context } from "./context";
import { Why } from "./why";

const ENVIRONMENT = { unknown: "unknown", los: "line of sight", mixed: "mixed", nlos: "no line of sight" } as const;

const GROUND: Record<string, string> = { terrain: "above ground", home: "above home", settings: "above ground" };

/** Above the ground where that is known: what a searcher asks; else above mean sea level. */
function height(context: Context, row: TargetRow, place: Place): string {
  const ground_m = context.store.mission?.ground_amsl_m;
  const from = GROUND[row.height_reference];
  if (ground_m === null || ground_m === undefined || from === undefined) return `${metres(place.altitude_amsl_m)} AMSL (ground not known)`;
  return `${metres(place.altitude_amsl_m - ground_m)} ${from}`;
}

/** Beliefs come every second or so: an older one says that the station is behind or nobody hears the beacon. */
const OLD_POSITION_S = 10;

async function copy(text: string): Promise<boolean> {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    // Not a secure context (the page by IP address on a tablet): the old way still works there.
    const area = document.createElement("textarea");
    area.value = text;
    document.body.append(area);
    area.select();
    const done = document.execCommand("copy");
    area.remove();
    return done;
  }
}

function Copy({ text, label }: { text: string; label: string }) {
  const [said, setSaid] = useState("");
  const click = (): void => {
    void copy(text).then((done) => {
      setSaid(done ? "copied" : "failed");
      window.setTimeout(() => setSaid(""), 1500);
    });
  };
  return (
    <button type="button" class="plain small" aria-label={label} data-testid="copy" onClick={click}>
      {said || "Copy"}
    </button>
  );
}

/** From here on the operator is told that the person may not stay where the estimate is. */
const MAY_WALK = 0.2;

/** An id that the operator said is another one's. */
function Joined({ context, row, heard }: { context: Context; row: TargetRow; heard: string }) {
  const into = shortId(row.joined_into ?? "");
  return (
    <li class="card beacon" data-testid={`beacon-${row.beacon_id}`} data-state={row.state}>
      <div class="where">
        <span title={row.beacon_id}><strong>Beacon {shortId(row.beacon_id)}</strong> joined into <span class="nowrap">{into}</span> · <span class="detail nowrap" data-testid="heard">{heard}</span></span>
        {!isReplay(context) && (
          <button type="button" class="plain small" data-testid={`separate-${row.beacon_id}`} onClick={() => context.act(`Separate beacon ${shortId(row.beacon_id)}`, separateBeacon(row.beacon_id))}>
            Separate
          </button>
        )}
      </div>
    </li>
  );
}

function Beacon({ context, row }: { context: Context; row: TargetRow }) {
  const key = `target:${row.beacon_id}`;
  const [open, setOpen] = useState(false);
  const ids = [row.beacon_id, ...row.joined_beacon_ids];
  // A radio link tells at once; the belief takes it in when its window is full, or later still when busy.
  const times = [...context.store.links.values()].filter((link) => ids.includes(link.beacon_id)).map((link) => link.last_heard_ns);
  const heard_s = ageOf(context, [row.last_heard_ns, ...times].reduce((a, b) => (BigInt(a) > BigInt(b) ? a : b)));
  const position_s = ageOf(context, row.time_ns) ?? 0;
  const heard = `heard ${heardAge(heard_s)}${heardAge(heard_s) === "now" ? "" : " ago"}`;
  const place = row.position;
  if (row.state === "joined") return <Joined context={context} row={row} heard={heard} />;
  const walking = row.walking_probability ?? 0;
  return (
    <li class={`card beacon ${context.selected === key ? "selected" : ""}`} data-testid={`beacon-${row.beacon_id}`} data-key={key} data-state={row.state}>
      <div class="card-head">
        {place ? (
          <button type="button" class="link" title={`Beacon ${row.beacon_id}: show on the map`} onClick={() => { context.select(key); context.show(place); }}>
            Beacon {shortId(row.beacon_id)}
          </button>
        ) : (
          <strong title={row.beacon_id}>Beacon {shortId(row.beacon_id)}</strong>
        )}
        {place && <strong class="radius nowrap">90 % within {metres(row.radius_90_m)}</strong>}
        {!place && <span class="muted nowrap">{heard}</span>}
      </div>
      {place ? (
        <>
          <div class="where">
            <code data-testid="coordinates">{coordinates(place)}</code>
            <span class="detail nowrap" data-testid="heard">{heard}</span>
            <Copy text={coordinates(place)} label={`Copy the coordinates of beacon ${row.beacon_id}`} />
          </div>
          <p class="detail">
            {position_s >= OLD_POSITION_S && <span class="old-position nowrap">position {age(position_s)} old · </span>}
            {walking >= MAY_WALK && <strong class="walking nowrap" data-testid="walking">may be walking ({probability(walking)}) · </strong>}
            {row.joined_beacon_ids.length > 0 && <span class="nowrap" data-testid="joined-ids">with {row.joined_beacon_ids.map(shortId).join(", ")} · </span>}
            <span title={`Environment: ${ENVIRONMENT[row.environment]}`}>{row.los_links ?? 0} of {row.links} links in line of sight</span> · <span class="nowrap">{height(context, row, place)}</span>
          </p>
        </>
      ) : (
        <p class="needed">Waiting: {row.needed}</p>
      )}
      <button type="button" class="plain small why-button" aria-expanded={open} data-testid={`why-button-${row.beacon_id}`} onClick={() => setOpen(!open)}>
        {open ? "▾" : "▸"} {place ? "Why there?" : "More"}
      </button>
      {open && <Why context={context} row={row} />}
    </li>
  );
}

export function Beacons({ context }: { context: Context }) {
  const rows = [...context.store.targets.values()].sort((a, b) => (BigInt(a.beacon_id) < BigInt(b.beacon_id) ? -1 : 1));
  return (
    <section aria-labelledby="beacons-title" data-testid="beacons">
      <h2 id="beacons-title">Beacons <span class="count">{rows.length}</span></h2>
      {rows.length === 0 && <p class="empty">None heard yet.</p>}
      <ul class="cards">{rows.map((row) => <Beacon key={row.beacon_id} context={context} row={row} />)}</ul>
    </section>
  );
}
