import type { Resource } from "rcp-client";

/** One robot, as its backend has it. */
export interface Robot {
  name: string;
  tenant: string;
  resources: Resource[];
}

/** Group what there is by robot, in the order of their names. */
export function robotsOf(resources: Resource[], backends: [name: string, tenant: string][]): Robot[] {
  const robots = new Map<string, Robot>();
  for (const [name, tenant] of backends) robots.set(name, { name, tenant, resources: [] });
  for (const resource of resources) {
    if (!resource.path.startsWith("/tenant/")) continue;
    const tenant = resource.path.split("/")[2] as string;
    let robot = robots.get(resource.backend);
    if (!robot) robots.set(resource.backend, (robot = { name: resource.backend, tenant, resources: [] }));
    robot.resources.push(resource);
  }
  return [...robots.values()].sort((a, b) => a.name.localeCompare(b.name));
}

/** The path below its tenant and branch: what tells resources of one robot apart. */
export function shortName(path: string): string {
  return path.startsWith("/tenant/") ? path.split("/").slice(3).join("/") : path.slice(1);
}
