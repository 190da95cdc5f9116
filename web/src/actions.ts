// What the operator can do, and the one line that comes back. A request that does not
// reach the station says so, with what to do instead.
import type { ActionAnswer, Problem } from "./wire";

export interface Outcome {
  ok: boolean;
  text: string;
}

const TIMEOUT_MS = 5_000;

async function post(path: string, body?: unknown): Promise<Outcome> {
  try {
    const response = await fetch(path, {
      method: "POST",
      headers: body === undefined ? {} : { "content-type": "application/json" },
      body: body === undefined ? null : JSON.stringify(body),
      signal: AbortSignal.timeout(TIMEOUT_MS),
    });
    const answer = (await response.json()) as ActionAnswer | Problem;
    return "accepted" in answer ? { ok: answer.accepted, text: answer.text } : { ok: false, text: answer.detail };
  } catch {
    return { ok: false, text: "the station did not answer. Nothing is known to have been sent: use the RC transmitter if it is urgent." };
  }
}

const id = encodeURIComponent;

export const confirmProposal = (proposal_id: string, vehicle_id: number): Promise<Outcome> =>
  post(`/api/v1/proposals/${id(proposal_id)}/confirm`, { vehicle_id });
export const dismissProposal = (proposal_id: string): Promise<Outcome> => post(`/api/v1/proposals/${id(proposal_id)}/dismiss`);
export const joinBeacons = (beacon_id: string, into_beacon_id: string): Promise<Outcome> =>
  post(`/api/v1/targets/${id(beacon_id)}/join`, { into_beacon_id });
export const separateBeacon = (beacon_id: string): Promise<Outcome> => post(`/api/v1/targets/${id(beacon_id)}/separate`);
export const holdVehicle = (vehicle_id: number): Promise<Outcome> => post(`/api/v1/vehicles/${vehicle_id}/hold`);
export const holdAll = (): Promise<Outcome> => post("/api/v1/hold-all");
