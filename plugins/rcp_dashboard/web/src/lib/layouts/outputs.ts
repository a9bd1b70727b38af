import type { Resource } from "rcp-client";

/**
 * Whether a plugin's panel may write it: a parameter, or an actuator that the gateway brings to rest when nobody writes any
 * more, so that a dead-man works.
 */
export function writable(one: Resource): boolean {
  if (!one.operations.includes("write") || !one.path.startsWith("/tenant/")) return false;
  return one.kind === "param" || (one.kind === "actuator" && one.safe !== undefined);
}
