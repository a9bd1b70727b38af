import type { LeaseState, Resource } from "rcp-client";

import type { Robot } from "./robots.ts";

const BRANCHES = new Set(["sensor", "actuator", "param", "action", "service", "event"]);

/** Whether a lease's scope reaches a path; `/tenant/<tenant>/<robot>` is the robot's part of every branch. */
export function covers(scope: string, path: string): boolean {
  if (path === scope || path.startsWith(`${scope}/`)) return true;
  const [, , tenant, robot, ...more] = scope.split("/");
  const parts = path.split("/");
  return robot !== undefined && more.length === 0 && !BRANCHES.has(robot) && parts[2] === tenant && parts[4] === robot;
}

export function leasesOf(robot: Robot, leases: LeaseState[]): LeaseState[] {
  return leases.filter((lease) => robot.resources.some((one: Resource) => covers(lease.scope, one.path)));
}
