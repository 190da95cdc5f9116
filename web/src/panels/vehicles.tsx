// Vehicles: mode, battery, height, link age, and a hold for each.
import { holdVehicle } from "../actions";
import { age, heardAge, metres, percent } from "../units";
import type { VehicleRow } from "../wire";
import { ageOf, isReplay, REPLAY_REFUSAL, type Context } from "./context";

const LOW_BATTERY_PERCENT = 30;
/** From here on bearings from 60 m off are as unsure of the place as of the direction. */
const VAGUE_PLACE_M = 3;

function Vehicle({ context, row }: { context: Context; row: VehicleRow }) {
  const key = `vehicle:${row.vehicle_id}`;
  const low = row.battery_percent !== null && row.battery_percent < LOW_BATTERY_PERCENT;
  const sensor_s = ageOf(context, row.sensor_heard_ns);
  const place = row.position;
  const notes = [
    !row.position && "no position",
    row.position_accuracy_m !== null && row.position_accuracy_m >= VAGUE_PLACE_M && `place only to ± ${metres(row.position_accuracy_m)}`,
    !row.clock_offset_known && "clock not matched",
    !row.ready && !row.armed && "not ready",
    sensor_s === null ? "no radio sensor" : sensor_s > 10 && `sensor silent ${age(sensor_s)}`,
    row.packet_loss_percent !== null && row.packet_loss_percent >= 1 && `${percent(row.packet_loss_percent)} of frames lost`,
  ].filter(Boolean);
  return (
    <tr class={`${row.lost ? "lost" : ""} ${context.selected === key ? "selected" : ""}`} data-testid={`vehicle-${row.vehicle_id}`} data-key={key}>
      <th scope="row">
        {place ? (
          <button type="button" class="link" aria-label={`Vehicle ${row.vehicle_id}: show on the map`} onClick={() => { context.select(key); context.show(place); }}>{row.vehicle_id}</button>
        ) : row.vehicle_id}
      </th>
      <td>
        <strong>{row.lost ? "LOST" : row.mode}</strong>
        {!row.lost && <span class="muted"> {row.armed ? "armed" : "disarmed"}</span>}
      </td>
      <td class="number">{metres(row.height_above_home_m)}</td>
      <td class="number">{row.ground_speed_m_s === null ? "–" : `${row.ground_speed_m_s.toFixed(0)} m/s`}</td>
      <td class={`number ${low ? "low" : ""}`}>{percent(row.battery_percent)}{low && <span class="sr"> low</span>}</td>
      <td class="number">{heardAge(ageOf(context, row.last_heartbeat_ns))}</td>
      <td class="note">{notes.join(", ")}</td>
      <td class="act">
        <button
          type="button" class="danger small" data-testid={`hold-${row.vehicle_id}`} aria-label={`Hold vehicle ${row.vehicle_id}`}
          disabled={isReplay(context)} title={isReplay(context) ? REPLAY_REFUSAL : undefined}
          onClick={() => context.act(`Hold vehicle ${row.vehicle_id}`, holdVehicle(row.vehicle_id))}
        >
          Hold
        </button>
      </td>
    </tr>
  );
}

export function Vehicles({ context }: { context: Context }) {
  const rows = [...context.store.vehicles.values()].sort((a, b) => a.vehicle_id - b.vehicle_id);
  return (
    <section data-testid="vehicles">
      {rows.length === 0 ? <p class="empty">None heard yet. Check the telemetry link under Status.</p> : (
        <table>
          <thead>
            <tr><th scope="col">Vehicle</th><th scope="col">Mode</th><th scope="col" class="number" title="Height above home">Height</th><th scope="col" class="number">Speed</th><th scope="col" class="number">Battery</th><th scope="col" class="number" title="Since the last heartbeat">Heard</th><th scope="col">Notes</th><th scope="col"><span class="sr">Hold</span></th></tr>
          </thead>
          <tbody>{rows.map((row) => <Vehicle key={row.vehicle_id} context={context} row={row} />)}</tbody>
        </table>
      )}
    </section>
  );
}
