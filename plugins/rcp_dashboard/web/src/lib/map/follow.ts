/** What robots report of their places on Earth. */
import type { Resource } from "rcp-client";

import { type Geo, geoOf } from "../geo.ts";
import type { Robot } from "../robots.ts";
import { unitOf } from "../schema.ts";
import { ofShape } from "../shapes.ts";
import { watch } from "../watch.ts";
import { distance } from "./check.ts";
import type { Track } from "./draw.ts";

const MOST = 5000; // places of a trail
const STEP = 0.3; // m between two of them
const STALE = 5; // s, where the source tells no deadline

export interface Followed extends Track {
  altitude: number | undefined;
  timestamp: string;
  deadline: number | undefined;
}

/** The sensor that tells where on Earth a robot is. */
export function globalOf(robot: Robot): Resource | undefined {
  const found = ofShape(robot.resources, "geo").filter((one) => one.kind === "sensor");
  return found.find((one) => /global/.test(one.path)) ?? found.find((one) => /position|fix|gps/.test(one.path)) ?? found[0];
}

/** The sensor that tells where its home is. */
export function homeOf(robot: Robot): Resource | undefined {
  return ofShape(robot.resources, "geo").find((one) => one.kind === "sensor" && /\/home$/.test(one.path) && one.operations.includes("subscribe"));
}

/** Follow a robot; `last` returns what was known of it before. Returns what ends it. */
export function follow(robot: Robot, geo: Resource, last: () => Followed | undefined, told: (now: Followed) => void): () => void {
  return watch(geo.path, { rate: 10 }, ({ body, timestamp }) => {
    const at = geoOf(body);
    if (!at) return;
    const trail = last()?.trail ?? [];
    const end = trail.at(-1);
    if (!end || distance(at, end) > STEP) trail.push(at);
    if (trail.length > MOST) trail.splice(0, MOST / 2);
    const field = typeof body.heading === "number" ? "heading" : "hdg";
    const said = typeof body[field] === "number" ? body[field] : undefined;
    const heading = said !== undefined && unitOf(geo, field) === "rad" ? (said * 180) / Math.PI : said;
    told({ name: robot.name, at, altitude: at.altitude, heading, trail, timestamp, deadline: geo.deadline ?? STALE });
  });
}

/** Tell of a robot's home; returns what ends it. */
export function followHome(home: Resource, told: (at: Geo) => void): () => void {
  return watch(home.path, { rate: 1 }, ({ body }) => {
    const at = geoOf(body);
    if (at) told({ latitude: at.latitude, longitude: at.longitude });
  });
}

/** Tell of which kind a robot is; returns what ends it. */
export function followKind(robot: Robot, told: (kind: string) => void): () => void {
  const sensor = robot.resources.find((one) => one.kind === "sensor" && one.path.endsWith("/sensor/vehicle") && one.operations.includes("subscribe"));
  if (!sensor) return () => undefined;
  return watch(sensor.path, { rate: 1 }, ({ body }) => {
    if (typeof body?.kind === "string") told(body.kind);
  });
}
