import type { Resource } from "rcp-client";

import { jointsOf } from "./joints.ts";
import { properties } from "./schema.ts";
import { ofShape } from "./shapes.ts";
import { steering } from "./twist.ts";

/** One robot, as its backend has it. */
export interface Robot {
  name: string;
  tenant: string;
  /** The segment after the branch in all of its paths, where its configuration gives it one. */
  place?: string | undefined;
  resources: Resource[];
}

/** Group what there is by robot, in the order of their names. */
export function robotsOf(resources: Resource[], backends: [name: string, tenant: string, place?: string | null][]): Robot[] {
  const robots = new Map<string, Robot>();
  for (const [name, tenant, place] of backends) robots.set(name, { name, tenant, place: place ?? undefined, resources: [] });
  for (const resource of resources) {
    if (!resource.path.startsWith("/tenant/")) continue;
    const tenant = resource.path.split("/")[2] as string;
    let robot = robots.get(resource.backend);
    if (!robot) robots.set(resource.backend, (robot = { name: resource.backend, tenant, resources: [] }));
    robot.resources.push(resource);
  }
  return [...robots.values()].sort((a, b) => a.name.localeCompare(b.name));
}

/** The scopes of each robot's resources among those that the inventory lists, by the robot's name. */
export function scopesOf(robots: Robot[], listed: ReadonlySet<string>): Map<string, string[]> {
  return new Map(
    robots.map(({ name, resources }) => {
      const scopes = resources.map(({ path }) => {
        const [, , tenant, , place, ...more] = path.split("/");
        const own = `/tenant/${tenant}/${place}`;
        return more.length && listed.has(own) ? own : `/tenant/${tenant}`;
      });
      return [name, [...new Set(scopes)].filter((scope) => listed.has(scope))];
    }),
  );
}

/** The robot of a name, or of a path as the inventory and incidents have it: `/tenant/alpha` or `/tenant/alpha/rover`. */
export function robotNamed(robots: Robot[], text: string): Robot | undefined {
  const [, branch, tenant, place] = text.split("/");
  const named = robots.find((one) => one.name === text);
  if (named || branch !== "tenant") return named;
  const within = (robot: Robot): boolean =>
    place === undefined ||
    robot.resources.some(({ path }) => {
      const [, , , , own, ...more] = path.split("/");
      return own === place && more.length > 0;
    });
  return robots.find((one) => one.tenant === tenant && within(one));
}

/** The path below its tenant and branch: what tells resources of one robot apart. */
export function shortName(path: string): string {
  return path.startsWith("/tenant/") ? path.split("/").slice(3).join("/") : path.slice(1);
}

/** What of a robot tells how it is, as far as it has such. */
export interface Vitals {
  pose: Resource | undefined;
  geo: Resource | undefined;
  joints: Resource | undefined;
  battery: Resource | undefined;
  mode: Resource | undefined;
  armed: Resource | undefined;
  alarms: Resource[];
}

const DEPTH = 5; // parts of the path of what stands for a whole robot: "", tenant, its name, sensor, name

export function vitals(robot: Robot): Vitals {
  const all = robot.resources.filter((one) => one.operations.includes("subscribe"));
  const sensor = (name: RegExp): Resource | undefined => all.find((one) => one.kind === "sensor" && name.test(one.path));
  const whole = all.filter((one) => one.path.split("/").length === DEPTH);
  return {
    pose: ofShape(all, "pose")[0] ?? ofShape(all, "odometry")[0],
    geo: sensor(/\/position\/global$/) ?? ofShape(all, "geo")[0],
    joints: sensor(/\/(joints|joint_states)$/),
    battery: sensor(/battery$/) ?? ofShape(all, "battery")[0],
    mode: sensor(/\/(flight_)?mode$/) ?? whole.find((one) => one.kind === "sensor" && /\/(state|status)$/.test(one.path)),
    armed: sensor(/\/armed$/),
    alarms: all.filter(alarming),
  };
}

/** Whether an event tells of trouble: by its severity, by coming and going, or by its name. */
export function alarming(one: Resource): boolean {
  if (one.kind !== "event") return false;
  const has = properties(one);
  return has.has("severity") || has.has("active") || /fault|alarm|error|failsafe|overflow/.test(one.path);
}

/**
 * Whether this role may drive it with a stick: what takes speeds goes on with the last one, unless it declares the value
 * that the gateway brings it to when nobody writes any more.
 */
export function steerable(one: Resource): boolean {
  return one.kind === "actuator" && one.operations.includes("write") && one.safe !== undefined && steering(one) !== undefined;
}

/** Whether this role may move something of it by hand. */
export function drivable(robot: Robot): boolean {
  return robot.resources.some((one) => steerable(one) || jointsOf(one) !== undefined);
}
