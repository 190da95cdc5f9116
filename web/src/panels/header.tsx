// The head of the page: what runs, whether it is live, and HOLD ALL, always in the same place.
import { holdAll } from "../actions";
import type { ThemeName } from "../themes/palette";
import { age } from "../units";
import { isReplay, REPLAY_REFUSAL, type Context } from "./context";

interface Props {
  context: Context;
  theme: ThemeName;
  setTheme(theme: ThemeName): void;
}

const WORDS = { connecting: "connecting", live: "live", stale: "no data", lost: "connection lost" } as const;

export function Header({ context, theme, setTheme }: Props) {
  const { store, connection } = context;
  const station = store.station;
  const source = station?.source === "replay" ? "REPLAY" : station?.source === "demo" ? "SIMULATION" : null;
  return (
    <header class="head">
      <h1>Ground station</h1>
      <span class={`badge state-${connection.state}`} data-testid="connection-state" role="status">
        {WORDS[connection.state]}
      </span>
      {source && <span class="badge source" data-testid="source">{source}</span>}
      {station?.title && <span class="title" title={station.title}>{station.title}</span>}
      <span class="spacer" />
      <button type="button" class="plain" data-testid="theme" onClick={() => setTheme(theme === "light" ? "dark" : "light")}>
        {theme === "light" ? "Dark" : "Light"}
      </button>
      <button type="button" class="danger hold-all" data-testid="hold-all" disabled={isReplay(context)} title={isReplay(context) ? REPLAY_REFUSAL : undefined} onClick={() => context.act("Hold all", holdAll())}>
        HOLD ALL
      </button>
    </header>
  );
}

/** What holds for as long as it holds: who else may command, and why nothing can be. */
function Standing({ context }: { context: Context }) {
  const { station, forwards } = context.store;
  const commanding = forwards.filter((forward) => forward.commanding);
  const blocked = station !== null && !station.commands_enabled;
  if (commanding.length === 0 && !blocked) return null;
  return (
    <div class="standing" role="status">
      {commanding.length > 0 && (
        <span data-testid="forward-commanding">Another ground station may command: {commanding.map((forward) => forward.url).join(", ")}</span>
      )}
      {blocked && <span data-testid="commands-disabled">{isReplay(context) ? "Replay of a recording: nothing is sent to any vehicle" : `No vehicle can be sent: ${station.commands_reason}`}</span>}
    </div>
  );
}

export function Banner({ context }: { context: Context }) {
  return (
    <div class="banners">
      <Standing context={context} />
      <Stream context={context} />
    </div>
  );
}

function Stream({ context }: { context: Context }) {
  const { connection } = context;
  if (connection.fault !== "") return <div class="banner" role="alert" data-testid="banner">The stream cannot be read: {connection.fault}</div>;
  if (connection.state === "live") return null;
  if (connection.silence_s === null) return <div class="banner calm" role="status" data-testid="banner">Connecting to the station…</div>;
  const what = connection.state === "stale" ? "No data from the station" : "Connection lost";
  return (
    <div class="banner" role="alert" data-testid="banner">
      {what} – what you see is {age(connection.silence_s)} old. {connection.state === "lost" && "Trying again…"}
    </div>
  );
}
