// Connections, other ground stations, and every total that is not zero.
import { age } from "../units";
import { ageOf, type Context } from "./context";

export function Status({ context }: { context: Context }) {
  const { store } = context;
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
