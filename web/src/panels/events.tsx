// The event log, newest first. Nothing is filtered unless the operator asks; the planner's
// notes on one subject share a line.
import { useState } from "preact/hooks";
import { clockTime } from "../units";
import type { Context } from "./context";
import { collapsed, readable } from "./notes";

const SHOWN = 200;
const SIGNS = { info: "·", warning: "▲", error: "✖" } as const;

export function Events({ context }: { context: Context }) {
  const [important, setImportant] = useState(false);
  const lines = collapsed(context.store.events.filter((event) => !important || event.severity !== "info")).slice(0, SHOWN);
  return (
    <div data-testid="events">
      <label class="filter"><input type="checkbox" checked={important} onChange={() => setImportant(!important)} /> warnings and errors only</label>
      {lines.length === 0 && <p class="empty">Nothing to report.</p>}
      <ol class="events">
        {lines.map(({ event, times }) => (
          <li key={event.number} class={event.severity} title={event.code}>
            <time>{clockTime(event.time_ns)}</time>
            <span class="sign" aria-label={event.severity}>{SIGNS[event.severity]}</span>
            <span>{readable(event.text)}{times > 1 && <span class="muted"> ({times} times)</span>}</span>
          </li>
        ))}
      </ol>
    </div>
  );
}
