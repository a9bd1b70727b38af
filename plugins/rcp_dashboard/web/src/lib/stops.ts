import type { EstopState, Resource } from "rcp-client";

import type { Robot } from "./robots.ts";

/** How far the stop of a robot has come; `alarm`: it had been at rest, and is so no more although it is latched. */
export type Phase = "requested" | "commanded" | "confirmed" | "alarm";

/** What `/system/estop` says of one robot that is latched. */
export interface Latched {
  /** The name of its latch: a backend, or `<backend>/<robot>`. */
  name: string;
  phase: Phase;
  by: string;
  reason: string;
  since: string;
  requested: string | undefined;
  commanded: string | undefined;
  confirmed: string | undefined;
  /** Why it is not confirmed to be at rest. */
  detail: string;
  /** Whether it has moved again since it was first at rest. */
  moved: boolean;
}

/** What can be stopped and held alone: a robot, or one of several of a backend. */
export interface Unit {
  /** The segment after the branch in its paths, where it has one. */
  place: string | undefined;
  /** What an emergency stop of it is sent with. */
  scope: string;
  /** Its `service/hold`, where this role may execute it. */
  hold: Resource | undefined;
}

const time = (value: unknown): string | undefined => (typeof value === "string" && value !== "" ? value : undefined);

function phaseOf(told: Record<string, unknown>): Phase {
  const { state, alarm } = told;
  if (state === "confirmed") return state;
  // What does not say that it is at rest is not at rest.
  return alarm === true ? "alarm" : state === "commanded" ? state : "requested";
}

/** Every robot that is latched, the ones that need a person first. */
export function latchedOf(estop: EstopState | undefined): Latched[] {
  const order: Phase[] = ["alarm", "requested", "commanded", "confirmed"];
  return Object.entries(estop?.robots ?? {})
    .map(([name, told]) => ({
      name,
      phase: phaseOf(told),
      by: String(told["by"] ?? "?"),
      reason: String(told["reason"] ?? ""),
      since: String(told["since"] ?? ""),
      requested: time(told["requested"]) ?? time(told["since"]),
      commanded: time(told["commanded"]),
      confirmed: time(told["confirmed"]),
      detail: String(told["detail"] ?? ""),
      moved: told["alarm"] === true,
    }))
    .sort((a, b) => order.indexOf(a.phase) - order.indexOf(b.phase) || a.name.localeCompare(b.name));
}

/** Whether a latch is on a robot, or on one of those that its backend fronts. */
export function isOf(robot: Robot, latch: string): boolean {
  return latch === robot.name || latch.startsWith(`${robot.name}/`) || (robot.place !== undefined && latch === `/tenant/${robot.tenant}/${robot.place}`);
}

/** The latch that holds what is at a path of a robot. */
export function holding(latched: Latched[], robot: Robot, path: string | undefined): Latched | undefined {
  const place = path?.split("/")[4];
  const mine = latched.filter((one) => isOf(robot, one.name));
  return mine.find((one) => !one.name.startsWith(`${robot.name}/`) || one.name === `${robot.name}/${place}`) ?? (place === undefined ? mine[0] : undefined);
}

const HOLD = /^\/tenant\/[^/]+\/service\/(?:([^/]+)\/)?hold$/;

/** Whether this is the pause that the gateway offers for every robot that moves. */
export function isHold(resource: Resource): boolean {
  return resource.kind === "service" && HOLD.test(resource.path);
}

/** What of a robot can be stopped alone: one, or each of those that its backend fronts. */
export function unitsOf(robot: Robot, byPath?: Map<string, Resource>): Unit[] {
  const shared = robot.place === undefined ? undefined : byPath?.get(`/tenant/${robot.tenant}/service/${robot.place}/hold`);
  const holds = robot.resources.filter((one) => isHold(one) && one.operations.includes("execute"));
  // Of two backends of one robot, one has the hold of both.
  if (holds.length === 0 && shared?.operations.includes("execute")) holds.push(shared);
  const places = holds.map((hold) => ({ hold, place: HOLD.exec(hold.path)?.[1] })).filter((one) => one.place !== undefined);
  if (places.length > 1) return places.map(({ hold, place }) => ({ hold, place, scope: `/tenant/${robot.tenant}/${place}` }));
  return [{ place: places[0]?.place, scope: robot.name, hold: holds[0] }];
}

/** Names in a row, so many of them that a line can hold them. */
export function named(names: string[], most = 4): string {
  const shown = names.slice(0, most).map((one) => (one.length > 40 ? `${one.slice(0, 39)}…` : one));
  const more = names.length - shown.length;
  return more > 0 ? `${shown.join(", ")} and ${more} more` : shown.join(", ");
}

/** What `/system/estop` names a latch of a tenant or of everything, as people do. */
export function scopeName(key: string): string {
  if (key === "*") return "every robot, including robots added later";
  return key.startsWith("/tenant/") ? `tenant ${key.slice("/tenant/".length)}, including robots added later` : key;
}

/** The names of groups of robots that one stop stops together. */
export function groupsOf(estop: EstopState | undefined): string[] {
  return (estop as { groups?: string[] } | undefined)?.groups ?? [];
}
