// The picture as this page knows it: rows by key, brought forward by snapshots and deltas.
// Rule: it never invents state; what it shows was in a message.
import type {
  CommandRow, ConnectionRow, CounterRow, Delta, EventRow, ExplanationRow, ForwardRow, Heartbeat, LinkRow, MissionRow,
  ProposalRow, RegionsRow, Rows, Snapshot, StationRow, TargetRow, VehicleRow,
} from "./wire";
import { distance_m } from "./units";

export type StreamMessage = Snapshot | Delta | Heartbeat;
export type Applied = "ok" | "gap";
export type Table =
  | "vehicles" | "links" | "targets" | "regions" | "explanations" | "proposals" | "commands" | "connections" | "counters" | "forwards"
  | "mission" | "station" | "events" | "trails";

const TABLE_OF = {
  vehicle: "vehicles", link: "links", target: "targets", regions: "regions", explanation: "explanations", proposal: "proposals", command: "commands", connection: "connections",
} as const;
const EVENTS_MAX = 500;
const TRAIL_MAX = 300;
const TRAIL_SPACING_M = 3;
export const SCHEMA_VERSION = 1;

export const linkKey = (row: { vehicle_id: number; beacon_id: string }): string => `${row.vehicle_id}:${row.beacon_id}`;
const counterKey = (row: CounterRow): string => `${row.name}${JSON.stringify(row.labels)}`;

export class Store {
  epoch = "";
  seq = -1;
  vehicles = new Map<number, VehicleRow>();
  links = new Map<string, LinkRow>();
  targets = new Map<string, TargetRow>();
  regions = new Map<string, RegionsRow>();
  explanations = new Map<string, ExplanationRow>();
  proposals = new Map<string, ProposalRow>();
  commands = new Map<string, CommandRow>();
  connections = new Map<string, ConnectionRow>();
  counters = new Map<string, CounterRow>();
  forwards: ForwardRow[] = [];
  mission: MissionRow | null = null;
  station: StationRow | null = null;
  events: EventRow[] = [];
  trails = new Map<number, number[][]>();
  /** Grows with every change of a table: what depends on it alone is drawn again alone. */
  readonly versions = new Map<Table, number>();

  version(table: Table): number {
    return this.versions.get(table) ?? 0;
  }

  /** Takes a message in; "gap" when a delta before it is missing, and then nothing was taken. */
  apply(message: StreamMessage): Applied {
    if (message.schema_version !== SCHEMA_VERSION) throw new Error(`schema ${String(message.schema_version)}: reload the page`);
    switch (message.type) {
      case "snapshot":
        this.reset(message);
        return "ok";
      case "delta":
        if (message.epoch !== this.epoch || message.previous_seq > this.seq) return "gap";
        if (message.seq <= this.seq) return "ok";
        this.forward(message);
        return "ok";
      case "heartbeat":
        return message.epoch === this.epoch && message.seq <= this.seq ? "ok" : "gap";
    }
  }

  private reset(message: Snapshot): void {
    const same = message.epoch === this.epoch;
    this.epoch = message.epoch;
    this.seq = message.seq;
    for (const table of [this.vehicles, this.links, this.targets, this.regions, this.explanations, this.proposals, this.commands, this.connections, this.counters]) table.clear();
    this.forwards = [];
    this.mission = null;
    this.station = null;
    this.trails = new Map(message.trails.map((trail) => [trail.vehicle_id, trail.points_deg]));
    this.merge(message.rows);
    const known = same ? this.events.filter((event) => event.number < (message.events[0]?.number ?? Infinity)) : [];
    this.events = [...known, ...message.events].slice(-EVENTS_MAX);
    const all: Table[] = ["vehicles", "links", "targets", "regions", "explanations", "proposals", "commands", "connections", "counters", "forwards", "mission", "station", "events", "trails"];
    all.forEach((table) => this.touch(table));
  }

  private forward(delta: Delta): void {
    this.seq = delta.seq;
    for (const { kind, key } of delta.removed) {
      switch (kind) {
        case "vehicle":
          this.vehicles.delete(Number(key));
          this.trails.delete(Number(key));
          break;
        case "link": this.links.delete(key); break;
        case "target": this.targets.delete(key); break;
        case "regions": this.regions.delete(key); break;
        case "explanation": this.explanations.delete(key); break;
        case "proposal": this.proposals.delete(key); break;
        case "command": this.commands.delete(key); break;
        case "connection": this.connections.delete(key); break;
      }
      this.touch(TABLE_OF[kind]);
    }
    for (const row of delta.rows.vehicles) this.extendTrail(row);
    this.merge(delta.rows);
    if (delta.events.length > 0) {
      this.events = [...this.events, ...delta.events].slice(-EVENTS_MAX);
      this.touch("events");
    }
  }

  private merge(rows: Rows): void {
    this.put("vehicles", this.vehicles, rows.vehicles, (row) => row.vehicle_id);
    this.put("links", this.links, rows.links, linkKey);
    this.put("targets", this.targets, rows.targets, (row) => row.beacon_id);
    this.put("regions", this.regions, rows.regions, (row) => row.beacon_id);
    this.put("explanations", this.explanations, rows.explanations, (row) => row.beacon_id);
    this.put("proposals", this.proposals, rows.proposals, (row) => row.proposal_id);
    this.put("commands", this.commands, rows.commands, (row) => row.command_id);
    this.put("connections", this.connections, rows.connections, (row) => row.connection);
    this.put("counters", this.counters, rows.counters, counterKey);
    if (rows.forwards !== null) { this.forwards = rows.forwards; this.touch("forwards"); }
    if (rows.mission !== null) { this.mission = rows.mission; this.touch("mission"); }
    if (rows.station !== null) { this.station = rows.station; this.touch("station"); }
  }

  private put<Key, Row>(table: Table, map: Map<Key, Row>, rows: Row[], key: (row: Row) => Key): void {
    for (const row of rows) map.set(key(row), row);
    if (rows.length > 0) this.touch(table);
  }

  private touch(table: Table): void {
    this.versions.set(table, this.version(table) + 1);
  }

  private extendTrail(row: VehicleRow): void {
    if (row.position === null) return;
    const trail = this.trails.get(row.vehicle_id) ?? [];
    const last = trail[trail.length - 1];
    const point = [row.position.longitude_deg, row.position.latitude_deg];
    if (last !== undefined) {
      const from = { longitude_deg: last[0] ?? 0, latitude_deg: last[1] ?? 0, altitude_amsl_m: 0 };
      if (distance_m(from, row.position) < TRAIL_SPACING_M) return;
    }
    this.trails.set(row.vehicle_id, [...trail, point].slice(-TRAIL_MAX));
    this.touch("trails");
  }
}
