import type { RcpError } from "rcp-client";

/** What to do on these pages, whatever the gateway advises: its words are for those who write messages. */
const ALWAYS: Record<string, string> = {
  adapter_unavailable: "Check that the robot is switched on and reachable. Overview shows the state of each backend.",
  approval_required: "Send the command from its form on Explore and press Ask for approval.",
  duplicate_request: "Send it again.",
  estop_active: "Make sure the robot is safe, then press Reset, or ask someone whose role may reset.",
  gap: "Load the page again to see the current values.",
  invalid_path: "Choose a resource on Explore.",
  invalid_value: "Enter a value that matches the schema; Explore shows it with examples.",
  lease_held: "Wait until the holder releases control, or take over on Teleop.",
  lease_lost: "Press Take control on Teleop.",
  lease_required: "Press Take control on Teleop first.",
  out_of_range: "Enter a value within the limits; Explore shows them.",
  overrun: "Load the page again; a faster connection helps.",
  payload_too_large: "Enter a shorter value.",
  rate_limited: "Wait a moment, then try again.",
  segment_corrupt: "Send it again.",
  segment_missing: "Send it again.",
  stale_command: "Send it again. If that does not help, the connection is slow, or the clocks of the gateway and its robots differ.",
  token_expired: "Log in with a new key or token.",
  unauthenticated: "Log in with a valid key or token.",
  unknown_path: "Choose a resource on Explore.",
  unsupported_operation: "Explore shows what each resource offers.",
  version_unsupported: "Load the page again: the gateway has another version now.",
};

/** Where the gateway may say something about this very case, what to do if that is in the words of messages. */
const OTHERWISE: Record<string, string> = {
  already_running: "Wait for the running command to end, or cancel it on Commands.",
  bad_request: "Correct what the message names; Explore shows what each resource takes.",
  cancelled: "Send it again if it is still needed.",
  deadline_exceeded: "Check the state of the robot on Overview before you send it again.",
  device_rejected: "Fix the cause that the robot reports, then send it again.",
  device_timeout: "Check the robot itself, and use its own emergency stop if it still moves. Overview shows its state.",
  filter_unsupported: "Load the page again; if that does not help, report it to the operator of the gateway.",
  forbidden: "Ask the operator of the gateway for a role that allows it, or log in with one that does.",
  internal: "Check the state of the robot on Overview, and report this to the operator of the gateway.",
  mode_forbids: "Switch the robot to a mode that allows it.",
  not_implemented: "This gateway does not support it.",
  precondition_failed: "Make the condition in the message true, then send it again.",
  queue_full: "Wait a moment, then send it again.",
};

/** Names of fields and requests, paths of the gateway's own, chapters of its documentation. */
const OF_MESSAGES = /`|\/system\/|\/rcp\/|docs\/|\[\[|\bdiscover\b|\bhello\b/;

/** Tell what to do next, in the words of the pages. */
export function remedyOf(error: RcpError): string {
  const always = ALWAYS[error.code];
  if (always !== undefined) return always;
  return OF_MESSAGES.test(error.remedy) ? (OTHERWISE[error.code] ?? "") : error.remedy;
}
