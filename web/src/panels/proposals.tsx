// Proposals and the commands that came of them. A confirmation takes two clicks; the second
// button names the vehicle and what it will do, and is bound to both. If the proposal is
// replaced in between, its card goes and with it the armed button.
import { useEffect, useState } from "preact/hooks";
import { confirmProposal, dismissProposal } from "../actions";
import { age, compass, distance_m, metres, milliseconds, shortId, unbroken } from "../units";
import type { CommandRow, ProposalRow } from "../wire";
import { ageOf, isReplay, type Context } from "./context";
import { planNotes, readable } from "./notes";
import { current, failure, HOLD_STEPS, isOver, reached, STEPS } from "./phases";

const ARMED_MS = 10_000;
const NOTES_SHOWN = 4;

function Offer({ context, row }: { context: Context; row: ProposalRow }) {
  const [armed, setArmed] = useState(false);
  const [busy, setBusy] = useState(false);
  useEffect(() => {
    if (!armed) return;
    const timer = window.setTimeout(() => setArmed(false), ARMED_MS);
    return () => window.clearTimeout(timer);
  }, [armed]);
  const { store, station_ms } = context;
  const vehicle = store.vehicles.get(row.vehicle_id);
  const from = vehicle?.position ?? null;
  // Old data is no ground to send anybody anywhere, and a replay cannot; holds stay possible.
  const live = context.connection.state === "live" && (store.station?.commands_enabled ?? true);
  const left_s = (milliseconds(row.expires_ns) - station_ms) / 1000;
  const way = from ? `${metres(distance_m(from, row.position))} ${compass(from, row.position)}` : "position unknown";
  const height = `${metres(row.height_above_home_m)} above home`;
  const send = (): void => {
    setBusy(true);
    const outcome = confirmProposal(row.proposal_id, row.vehicle_id);
    void outcome.then(() => {
      setBusy(false);
      setArmed(false);
    });
    context.act(`Send vehicle ${row.vehicle_id}`, outcome);
  };
  const key = `proposal:${row.proposal_id}`;
  return (
    <li class={`card offer ${context.selected === key ? "selected" : ""}`} data-testid={`proposal-${row.proposal_id}`} data-key={key}>
      <div class="card-head">
        <button type="button" class="link" onClick={() => context.show(row.position)}>
          Vehicle {row.vehicle_id} → {way}
        </button>
        {!armed && (
          <div class="buttons">
            <button type="button" class="primary" data-testid={`proposal-confirm-${row.proposal_id}`} disabled={!live || left_s <= 0} onClick={() => setArmed(true)}>
              Confirm…
            </button>
            <button
              type="button" class="plain" data-testid={`proposal-dismiss-${row.proposal_id}`} disabled={isReplay(context)}
              aria-label={`Dismiss the proposal for vehicle ${row.vehicle_id}`} title="Dismiss"
              onClick={() => context.act(`Dismiss proposal for vehicle ${row.vehicle_id}`, dismissProposal(row.proposal_id))}
            >
              ✕
            </button>
          </div>
        )}
      </div>
      <p>
        {sentence(row.reason)}{" "}
        <span class="muted">
          · {!row.reason.includes(row.beacon_id) && <><span class="nowrap">Beacon {shortId(row.beacon_id)}</span> · </>}<span class="nowrap">{height}</span> · <span class="nowrap">{left_s > 0 ? `${age(left_s)} left` : "expired"}</span>
        </span>
      </p>
      {/* Elsewhere than the first button: a double click sends nobody. */}
      {armed && (
        <div class="buttons">
          <button type="button" class="go" data-testid={`proposal-send-${row.proposal_id}`} disabled={busy || !live || left_s <= 0} onClick={send}>
            Send vehicle {row.vehicle_id}: {way}, at {height}
          </button>
          <button type="button" class="plain" data-testid={`proposal-cancel-${row.proposal_id}`} onClick={() => setArmed(false)}>Cancel</button>
        </div>
      )}
    </li>
  );
}

const sentence = (text: string): string => unbroken(readable(text.charAt(0).toUpperCase() + text.slice(1)));

/** Why there is not more: the planner's newest word on each vehicle and beacon. */
function Notes({ context }: { context: Context }) {
  const notes = planNotes(context.store.events, context.store.proposals.values(), context.station_ms);
  if (notes.length === 0) return null;
  return (
    <details class="notes" open data-testid="plan-notes">
      <summary>Why not more <span class="count">{notes.length}</span></summary>
      <ul>
        {notes.slice(0, NOTES_SHOWN).map((note) => (
          <li key={note.subject}><span>{sentence(note.text)}</span> <span class="muted nowrap">{age(ageOf(context, note.time_ns))} ago</span></li>
        ))}
        {notes.length > NOTES_SHOWN && <li class="muted">and {notes.length - NOTES_SHOWN} older, see Events</li>}
      </ul>
    </details>
  );
}

function Command({ context, row }: { context: Context; row: CommandRow }) {
  const steps = row.kind === "hold" ? HOLD_STEPS : STEPS;
  const bad = failure(row.phase);
  // What is over needs no steps: one line, so that those under way stay in sight.
  const done = isOver(row.phase) && !bad;
  const count = reached(row.phase, steps);
  const from = context.store.vehicles.get(row.vehicle_id)?.position;
  const left = row.kind === "reposition" && row.target && from && !bad ? `, ${metres(distance_m(from, row.target))} to go` : "";
  return (
    <li class={`card command ${bad ? "bad" : ""}`} data-testid={`command-vehicle-${row.vehicle_id}`} data-phase={row.phase}>
      <div class="card-head">
        <strong>Vehicle {row.vehicle_id}: {done ? row.phase : row.kind === "hold" ? "hold" : "fly"}{row.phase === "flying" ? left : ""}</strong>
        <span class="muted nowrap">{age(ageOf(context, row.time_ns))} ago</span>
      </div>
      {done ? null : bad ? (
        <p><strong>{bad}</strong>{row.detail && `: ${row.detail}`}</p>
      ) : (
        <ol class="steps">
          {steps.map((step, index) => (
            <li key={step.phase} class={index < count ? "done" : ""} aria-current={index === count - 1 ? "step" : undefined}>
              {step.text}
            </li>
          ))}
        </ol>
      )}
    </li>
  );
}

export function Proposals({ context }: { context: Context }) {
  const { store } = context;
  const offers = [...store.proposals.values()].sort((a, b) => a.vehicle_id - b.vehicle_id);
  const commands = current(store.commands.values(), context.station_ms, milliseconds);
  const vehicleIds = [...new Set([...offers, ...commands].map((row) => row.vehicle_id))].sort((a, b) => a - b);
  return (
    <section aria-labelledby="proposals-title" data-testid="proposals">
      <h2 id="proposals-title">Proposals <span class="count">{offers.length}</span></h2>
      {offers.length === 0 && commands.length === 0 && (
        <p class="empty">{isReplay(context) ? "A replay proposes nothing." : "None now. One appears when another place would tell more about a beacon."}</p>
      )}
      <ul class="cards">
        {/* By vehicle: what was confirmed goes on where its proposal stood. */}
        {vehicleIds.flatMap((vehicle_id) => [
          ...offers.filter((row) => row.vehicle_id === vehicle_id).map((row) => <Offer key={row.proposal_id} context={context} row={row} />),
          ...commands.filter((row) => row.vehicle_id === vehicle_id).map((row) => <Command key={row.command_id} context={context} row={row} />),
        ])}
      </ul>
      <Notes context={context} />
    </section>
  );
}
