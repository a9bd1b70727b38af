import type { Resource } from "rcp-client";

/** One robot, as its backend has it. */
export interface Robot {
  name: string;
  tenant: string;
  health: any;
  resources: Resource[];
}

/** Group what there is by robot, in the order of their names. */
export function robotsOf(resources: Resource[], status: any): Robot[] {
  const health = new Map<string, any>((status?.backends ?? []).map((one: any) => [one.name, one]));
  const robots = new Map<string, Robot>();
  for (const [name, one] of health)
    robots.set(name, { name, tenant: one.tenant, health: one, resources: [] });
  for (const resource of resources) {
    if (!resource.path.startsWith("/tenant/")) continue;
    const tenant = resource.path.split("/")[2] as string;
    let robot = robots.get(resource.backend);
    if (!robot) robots.set(resource.backend, (robot = { name: resource.backend, tenant, health: undefined, resources: [] }));
    robot.resources.push(resource);
  }
  return [...robots.values()].sort((a, b) => a.name.localeCompare(b.name));
}

/** The path below its tenant and branch: what tells resources of one robot apart. */
export function shortName(path: string): string {
  return path.startsWith("/tenant/") ? path.split("/").slice(3).join("/") : path.slice(1);
}
