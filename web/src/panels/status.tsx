// For the engineer: connections, other ground stations, each vehicle's own radio and clock, and every total that
// is not zero.
import { age, metres, percent, uncertainty } from "../units";
import { ageOf, type Context } from "./context";

const PLACE_HELP = "What its GPS says of its own place: root mean square of the horizontal error. RTK is taken at its word; without it nobody is taken to know better than the settings assume";
const CLOCK_HELP =
  "How far this autopilot's times may be off the station's: what TIMESYNC bounds where it answers, else an assumed delay. " +
  "Pose and radio samples come by the same radio and are late together: positions are not moved by it.";

export function Status({ context }: { context: Context }) {
  const { store } = context;
  const vehicles = [...store.vehicles.values()].sort((a, b) => a.vehicle_id - b.vehicle_id);
  const counters = [...store.counters.values()].filter((row) => row.value_count > 0).sort((a, b) => a.name.localeCompare(b.name));
  return (
    <div class="status" data-testid="status">
      <table>
        <thead><tr><th scope="col">Connection</th><th scope="col">State</th><th scope="col">Since</th><th scope="col">Detail</th></tr></thead>
        <tbody>
          {[...store.connections.values()].map((row) => (
            <tr key={row.connection}><td><code>{row.connection}</code></td><td><strong>{row.state}</strong></td><td>{age(ageOf(context, row.time_ns))}</td><td>{row.detail}</td></tr>
          ))}
          {store.forwards.map((row) => (
            <tr key={row.url}><td><code>{row.url}</code></td><td><strong>{row.commanding ? "may command" : "listens"}</strong></td><td>–</td><td>another ground station{row.connected ? "" : ", not heard lately"}</td></tr>
          ))}
        </tbody>
      </table>
      {vehicles.length > 0 && (
        <table>
          <thead>
            <tr>
              <th scope="col">Vehicle</th><th scope="col">Autopilot</th><th scope="col" class="number" title="Satellites in use">Satellites</th><th scope="col" class="number" title={PLACE_HELP}>Place</th>
              <th scope="col" class="number" title="Frames lost on the way here in the last minute">Frames lost</th><th scope="col" class="number" title={CLOCK_HELP}>Clock</th><th scope="col">Heard on</th>
            </tr>
          </thead>
          <tbody>
            {vehicles.map((row) => (
              <tr key={row.vehicle_id} data-testid={`status-vehicle-${row.vehicle_id}`}>
                <td>{row.vehicle_id}</td><td>{row.autopilot}</td><td class="number">{row.satellites ?? "–"}</td><td class="number" title={PLACE_HELP}>{row.position_accuracy_m === null ? "–" : `± ${metres(row.position_accuracy_m, row.position_accuracy_m < 1 ? 2 : 1)}`}</td><td class="number">{percent(row.packet_loss_percent)}</td>
                <td class="number" title={CLOCK_HELP}>{uncertainty(row.clock_uncertainty_s)}</td><td><code>{row.connections.join(", ")}</code></td>
              </tr>
            ))}
          </tbody>
        </table>
      )}
      {counters.length > 0 && (
        <table>
          <thead><tr><th scope="col">Total</th><th scope="col">Of</th><th scope="col" class="number">Count</th></tr></thead>
          <tbody>
            {counters.map((row) => (
              <tr key={row.name + JSON.stringify(row.labels)}><td><code>{row.name}</code></td><td>{Object.entries(row.labels).map(([key, value]) => `${key} ${value}`).join(", ")}</td><td class="number">{row.value_count}</td></tr>
            ))}
          </tbody>
        </table>
      )}
    </div>
  );
}
