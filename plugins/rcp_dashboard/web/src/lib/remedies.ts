import type { RcpError } from "rcp-client";

/** What to do on these pages, where the wire's own words would not help here. */
const REMEDIES: Record<string, string> = {
  adapter_unavailable: "Check that the robot is switched on and reachable. Overview shows the state of each backend.",
  approval_required: "Send the command from its form on Explore and press Ask for approval.",
  estop_active: "Make sure the robot is safe, then press Reset, or ask someone whose role may reset.",
  invalid_value: "Enter a value that matches the schema; Explore shows it with examples.",
  lease_held: "Wait until the holder releases control, or take over on Teleop.",
  lease_lost: "Press Take control on Teleop.",
  lease_required: "Press Take control on Teleop first.",
  out_of_range: "Enter a value within the limits; Explore shows them.",
  token_expired: "Log in with a new key or token.",
  unauthenticated: "Log in with a valid key or token.",
  unknown_path: "Choose a resource on Explore.",
};

/** Tell what to do next, in the words of the pages. */
export const remedyOf = (error: RcpError): string => REMEDIES[error.code ?? ""] ?? error.remedy;
