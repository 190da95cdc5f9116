// The page: composes the panels and the map. Preact (5 kB) earns its place by one thing: six
// tables change ten times a second while the operator's focus stays on the button under it.
import { useEffect, useRef, useState } from "preact/hooks";
import type { Outcome } from "./actions";
import type { Connection } from "./connection";
import type { Fetched } from "./fetched";
import { MapView } from "./map/index";
import { Beacons } from "./panels/beacons";
import type { Context } from "./panels/context";
import { Events } from "./panels/events";
import { Banner, Header } from "./panels/header";
import { Legend } from "./panels/legend";
import { Links } from "./panels/links";
import { Proposals } from "./panels/proposals";
import { Status } from "./panels/status";
import { Vehicles } from "./panels/vehicles";
import { useRemembered } from "./remembered";
import type { Store } from "./store";
import type { ThemeName } from "./themes/palette";

export interface Props {
  store: Store;
  connection: Connection;
  fetched: Fetched;
  /** Calls back after every change, at most once a frame; returns how to stop. */
  subscribe(callback: () => void): () => void;
}

interface Notice extends Outcome {
  id: number;
  what: string;
}

const TABS = ["Vehicles", "Links", "Events", "Status"] as const;
type Tab = (typeof TABS)[number];
const NOTICE_MS = 8_000;
let notices = 0;

export function App({ store, connection, fetched, subscribe }: Props) {
  const [, setFrame] = useState(0);
  const [theme, setTheme] = useRemembered<ThemeName>("theme", ["light", "dark"]);
  const [tab, setTab] = useState<Tab>("Vehicles");
  /** The newest event that was on the screen: errors after it are counted on the tab. */
  const [seen, setSeen] = useState({ epoch: "", number: 0 });
  const [selected, setSelected] = useState("");
  const [shown, setShown] = useState<Notice[]>([]);
  const [spacing_m, setSpacing] = useState(0);
  const [searchMap, setSearchMap] = useRemembered("search-map", ["hidden", "shown"]);
  const container = useRef<HTMLDivElement>(null);
  const view = useRef<MapView | null>(null);

  useEffect(() => subscribe(() => {
    view.current?.update();
    setFrame((frame) => frame + 1);
  }), []);
  useEffect(() => {
    // Ages count up even when nothing arrives.
    const timer = window.setInterval(() => setFrame((frame) => frame + 1), 500);
    return () => window.clearInterval(timer);
  }, []);
  useEffect(() => {
    if (container.current && !view.current) view.current = new MapView(container.current, store, theme, choose, setSpacing, fetched);
  }, []);
  useEffect(() => {
    document.documentElement.dataset["theme"] = theme;
    view.current?.setTheme(theme);
  }, [theme]);

  useEffect(() => view.current?.setSelected(selected), [selected]);
  useEffect(() => {
    view.current?.setSearchMap(searchMap === "shown");
  }, [searchMap]);
  useEffect(() => fetched.forget(), [store.epoch]);

  function choose(key: string): void {
    setSelected(key);
    if (key.startsWith("link:")) setTab("Links");
    if (key.startsWith("vehicle:")) setTab("Vehicles");
    requestAnimationFrame(() => document.querySelector(`[data-key="${CSS.escape(key)}"]`)?.scrollIntoView({ block: "nearest" }));
  }

  function act(what: string, outcome: Promise<Outcome>): void {
    void outcome.then(({ ok, text }) => {
      const notice = { id: ++notices, what, ok, text };
      setShown((known) => [...known.slice(-2), notice]);
      // What went wrong stays until it is closed.
      if (ok) window.setTimeout(() => setShown((known) => known.filter(({ id }) => id !== notice.id)), NOTICE_MS);
    });
  }

  const context: Context = {
    store, connection, fetched, selected, act,
    // A replay's time runs and stands as it likes: nothing is counted on beyond its newest message.
    station_ms: store.station?.source === "replay" ? connection.clock.newest_ms : connection.clock.station_ms(),
    select: choose,
    show: (place) => view.current?.flyTo(place),
  };
  const newest = store.events[store.events.length - 1]?.number ?? 0;
  useEffect(() => {
    if (tab === "Events") setSeen({ epoch: store.epoch, number: newest });
  }, [tab, newest, store.epoch]);
  const alarms = store.events.filter((event) => event.severity === "error" && !(seen.epoch === store.epoch && event.number <= seen.number)).length;
  return (
    <div class={`page ${connection.state === "live" ? "" : "old"}`}>
      <Header context={context} theme={theme} setTheme={setTheme} />
      <Banner context={context} />
      <main>
        <div class="left">
          <div class="map-frame">
            <div class="map" ref={container} data-testid="map" role="application" aria-label="Map of vehicles and beacons; the same is in the tables" />
            <Legend context={context} spacing_m={spacing_m} view={view.current} searchMap={searchMap === "shown"} setSearchMap={(shown) => setSearchMap(shown ? "shown" : "hidden")} />
            <div class="notices" aria-live="assertive">
              {shown.map((notice) => (
                <div key={notice.id} class={`notice ${notice.ok ? "" : "bad"}`} role={notice.ok ? "status" : "alert"} data-testid="notice">
                  <span><strong>{notice.what}{notice.ok ? ":" : " – NOT DONE:"}</strong> {notice.text}</span>
                  <button type="button" class="plain small" aria-label="Close" onClick={() => setShown((known) => known.filter(({ id }) => id !== notice.id))}>✕</button>
                </div>
              ))}
            </div>
          </div>
          {/* The vehicles stay in sight where there is room for both; else they are the first tab. */}
          <section class={`drawer ${tab === "Vehicles" ? "first" : ""}`}>
            <div class="drawer-vehicles" role="tabpanel" id="panel-Vehicles" aria-label="Vehicles" tabIndex={0}>
              <Vehicles context={context} />
            </div>
            <div class="drawer-tabs">
              <div role="tablist" aria-label="Details">
                {TABS.map((name) => (
                  <button
                    key={name} type="button" role="tab" id={`tab-${name}`} aria-selected={tab === name}
                    aria-controls={name === "Vehicles" ? "panel-Vehicles" : "drawer-body"} data-testid={`tab-${name.toLowerCase()}`} onClick={() => setTab(name)}
                  >
                    {name}{name === "Vehicles" && ` ${store.vehicles.size}`}{name === "Links" && ` ${store.links.size}`}
                    {name === "Events" && alarms > 0 && <span class="alarm" title="errors not looked at yet" data-testid="alarms">{alarms}</span>}
                  </button>
                ))}
              </div>
              <div id="drawer-body" role="tabpanel" aria-labelledby={`tab-${tab}`} tabIndex={0}>
                {(tab === "Links" || tab === "Vehicles") && <Links context={context} />}
                {tab === "Events" && <Events context={context} />}
                {tab === "Status" && <Status context={context} />}
              </div>
            </div>
          </section>
        </div>
        <aside aria-label="Proposals and beacons">
          <Proposals context={context} />
          <Beacons context={context} />
        </aside>
      </main>
    </div>
  );
}
