// Radio links: who hears whom, how strongly, and whether in line of sight.
import { isClassified } from "../map/links";
import { linkKey } from "../store";
import { dbm, heardAge, probability, shortId } from "../units";
import { ageOf, type Context } from "./context";

export function Links({ context }: { context: Context }) {
  const rows = [...context.store.links.values()].sort(
    (a, b) => a.vehicle_id - b.vehicle_id || (BigInt(a.beacon_id) < BigInt(b.beacon_id) ? -1 : 1),
  );
  if (rows.length === 0) return <p class="empty">No beacon is heard yet.</p>;
  return (
    <table data-testid="links">
      <thead>
        <tr>
          <th scope="col">Vehicle</th><th scope="col">Beacon</th><th scope="col">Line of sight</th><th scope="col" class="number">Power</th>
          <th scope="col" class="number">Noise</th><th scope="col" class="number">Samples</th><th scope="col" class="number" title="Whole impulse responses (and those that lost a part)">CIRs</th><th scope="col" class="number">Heard</th>
        </tr>
      </thead>
      <tbody>
        {rows.map((row) => {
          const known = isClassified(row);
          const key = `link:${linkKey(row)}`;
          return (
            <tr key={key} data-key={key} data-testid={`link-${linkKey(row)}`} class={context.selected === key ? "selected" : ""}>
              <td>{row.vehicle_id}</td>
              <td class="nowrap" title={row.beacon_id}>{shortId(row.beacon_id)}</td>
              <td>
                {known ? (
                  <>
                    <span class="los" aria-hidden="true"><i style={{ width: `${(row.los_probability ?? 0) * 100}%` }} /></span>
                    {probability(row.los_probability)} <span class="muted">{row.los_source}</span>
                  </>
                ) : (
                  <span class="muted" title={row.los_reason}>unclassified{row.los_reason && `: ${row.los_reason}`}</span>
                )}
              </td>
              <td class="number">{dbm(row.rss_dbm)}</td>
              <td class="number">{dbm(row.noise_dbm)}</td>
              <td class="number">{row.samples_total}</td>
              <td class="number">{row.captures_total}{row.captures_incomplete_total > 0 && <span class="muted"> ({row.captures_incomplete_total})</span>}</td>
              <td class="number">{heardAge(ageOf(context, row.last_heard_ns))}</td>
            </tr>
          );
        })}
      </tbody>
    </table>
  );
}
