/** Words of the gateway's messages, as operators say them. */
import { amount } from "./format.ts";
import { say, vocabulary } from "./language.svelte.ts";

const STATES: Record<string, string> = {
  in_progress: "running",
  device_timeout: "no answer",
};

vocabulary("accepted", "active", "approved", "auto", "cancelled", "completed", "critical", "degraded", "down", "error", "expired", "failed", "fresh", "incident", "kept", "not started", "ok", "open", "paused");
vocabulary("pending", "ready", "recording", "recovered", "rejected", "running", "skipped", "stale", "starting", "stopped", "unavailable", "unknown", "used", "warning", "complete", "lost", "closed", "no mission", "always");

/** What an error is, at the head of its message. */
const ERRORS: Record<string, string> = {
  adapter_unavailable: "Robot not reachable",
  already_running: "Already running",
  approval_required: "Approval required",
  bad_request: "Not understood",
  connection_lost: "Connection lost",
  deadline_exceeded: "Took too long",
  device_rejected: "Refused by the robot",
  device_timeout: "No confirmation from the robot",
  estop_active: "Emergency stop active",
  forbidden: "Not permitted",
  internal: "Fault in the gateway",
  invalid_value: "Value not accepted",
  lease_held: "Someone else has control",
  lease_lost: "Control lost",
  lease_required: "Control required",
  mode_forbids: "Not possible in this mode",
  not_sent: "Not sent",
  out_of_range: "Outside the limits",
  precondition_failed: "Not possible now",
  queue_full: "Too many commands waiting",
  rate_limited: "Too many requests",
  stale_command: "Too old",
  token_expired: "Login expired",
  unauthenticated: "Not logged in",
  unknown_path: "Not found",
  unsupported_operation: "Not offered",
};

const plain = (code: string): string => code.replaceAll("_", " ");

/** A state of a command, plan, robot or value. */
export function stateWord(state: string): string {
  return say(STATES[state] ?? plain(state));
}

/** The kind of an error; codes of plugins are written out. */
export function errorWord(code: string | undefined): string {
  if (code === undefined) return "Error";
  const text = ERRORS[code] ?? plain(code);
  return text.charAt(0).toUpperCase() + text.slice(1);
}

/** A number of things in words. */
export const many = (count: number, one: string, more: string): string => `${amount(count)} ${count === 1 ? one : more}`;
