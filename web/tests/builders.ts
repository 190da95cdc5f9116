// Messages for tests, as small as the types allow.
import type { Delta, EventRow, ExplanationRow, Heartbeat, LastKnownRow, LinkRow, MissionRow, ProposalRow, RegionsRow, Rows, Snapshot, TargetRow, VehicleRow } from "../src/wire";

export const rows = (changes: Partial<Rows> = {}): Rows => ({
  vehicles: [], links: [], targets: [], regions: [], explanations: [], proposals: [], commands: [], connections: [], counters: [],
  forwards: null, mission: null, station: null, ...changes,
});

export const snapshot = (seq: number, changes: Partial<Snapshot> = {}): Snapshot => ({
  type: "snapshot", schema_version: 1, epoch: "e", seq, server_time_ns: "1000000000000", rows: rows(), trails: [], events: [], ...changes,
});

export const delta = (seq: number, changes: Partial<Delta> = {}): Delta => ({
  type: "delta", schema_version: 1, epoch: "e", seq, previous_seq: seq - 1, server_time_ns: "1000000000000", rows: rows(), removed: [], events: [], ...changes,
});

export const heartbeat = (seq: number, server_time_ns = "1000000000000"): Heartbeat => ({
  type: "heartbeat", schema_version: 1, epoch: "e", seq, server_time_ns,
});

export const vehicle = (vehicle_id: number, east_deg = 0): VehicleRow => ({
  vehicle_id, time_ns: "1", connections: [], autopilot: "ardupilot", mode: "GUIDED", armed: true, ready: true, lost: false,
  last_heartbeat_ns: "1", position: { latitude_deg: 0.5, longitude_deg: 10 + east_deg, altitude_amsl_m: 0 }, position_time_ns: "1",
  height_above_home_m: 50, home: null, heading_deg: 0, ground_speed_m_s: 0, climb_rate_m_s: 0, battery_percent: null, battery_voltage_v: null,
  gps_fix_type: 3, satellites: 10, position_accuracy_m: null, position_target: null, sensor_heard_ns: null, packet_loss_percent: null, clock_offset_known: true, clock_uncertainty_s: null,
});

export const link = (vehicle_id: number, beacon_id: string): LinkRow => ({
  vehicle_id, beacon_id, last_heard_ns: "1", rss_dbm: -70, noise_dbm: null, samples_total: 1, captures_total: 0, captures_incomplete_total: 0,
  los_probability: null, los_source: null, los_reason: "", verdict_time_ns: null, azimuth_rad: null, elevation_rad: null,
});

export const event = (number: number): EventRow => ({
  number, time_ns: "1", code: "a.b", severity: "info", text: `event ${number}`, vehicle_id: null, beacon_id: null,
});

export const target = (beacon_id: string, time_s = 100): TargetRow => ({
  beacon_id, state: "located", joined_into: null, joined_beacon_ids: [], walking_probability: null, time_ns: `${time_s}000000000`, first_heard_ns: "1", last_heard_ns: "1", links: 3, los_links: 1, needed: "",
  position: { latitude_deg: 0.5, longitude_deg: 10, altitude_amsl_m: 0 }, covariance_enu_m2: [9, 0, 0, 4, 0, 1], radius_90_m: 8,
  environment: "mixed", method: "adaptive", windows: 9, height_reference: "home", sequence: 1, snapshot_position: null,
  snapshot_method: null, snapshot_status: null,
});

export const regions = (beacon_id: string, time_s = 100, side_deg = 1e-3): RegionsRow => ({
  beacon_id, time_ns: `${time_s}000000000`,
  regions: [0.5, 0.9, 0.95].map((share) => {
    const side = share * side_deg;
    return { share, polygons_deg: [[[[10, 0.5], [10 + side, 0.5], [10 + side, 0.5 + side], [10, 0.5 + side], [10, 0.5]]]] };
  }),
});

export const proposal = (proposal_id: string, vehicle_id: number, beacon_id: string, created_s: number): ProposalRow => ({
  proposal_id, vehicle_id, beacon_id, position: { latitude_deg: 0.5, longitude_deg: 10, altitude_amsl_m: 50 }, height_above_home_m: 50,
  reason: "why", created_ns: `${created_s}000000000`, expires_ns: "999000000000", mission_revision: 1, target_sequence: 1,
});

export const lastKnown = (changes: Partial<LastKnownRow> = {}): LastKnownRow => ({
  latitude_deg: 0.5, longitude_deg: 10, radius_m: 80, name: "", beacon_id: null, ...changes,
});

export const mission = (changes: Partial<MissionRow> = {}): MissionRow => ({
  revision: 1, origin: null, search_area: null, fence: null, target_height_min_m: 0, target_height_max_m: 20, ground_amsl_m: null,
  height_reference: "unknown", last_known: [],
  limits: { floor_m: 20, ceiling_m: 120, separation_m: 15, fence_margin_m: 5, stale_pose_s: 3, max_leg_m: 2000 }, ...changes,
});

export const explanation = (beacon_id: string, sequence: number): ExplanationRow => ({ beacon_id, time_ns: "1", sequence, contributions: [] });
