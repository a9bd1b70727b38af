import type { Resource, SubscribeOptions } from "rcp-client";

import { app } from "../app.svelte.ts";
import { bytesOf } from "../bytes.ts";
import { properties } from "../schema.ts";
import { ofShape, poseOfNed, type Shape, shapes } from "../shapes.ts";
import { watch } from "../watch.ts";
import type { Fetch } from "./meshes.ts";
import type { Source } from "./report.ts";
import type { World } from "./world.ts";

const BYTES = { encoding: "msgpack" } as const; // of what is bytes: JSON is faster for all else
// What adds to what came before is not left out; but what waits for a slow page must not hold up its commands.
const FEW = { qos: { depth: 16 } } as const; // of what is large
const MANY = { qos: { depth: 256 } } as const; // of what is small, and may come all at once
const DRAWN: [Shape, Source, SubscribeOptions][] = [
  ["scan", "scan", { rate: 10 }],
  ["cloud", "cloud", { rate: 5, ...BYTES }],
  ["path", "path", { rate: 5 }],
  ["poses", "poses", { rate: 5 }],
  ["polygon", "polygon", { rate: 5 }],
  ["detections", "detections", { rate: 10 }],
];
const COSTS = /cost/; // in the name of a grid
const UPDATES = /_updates$/;
const STARS = ["base_link", "base_footprint", "odom", "map"];
const NOT_ITS_OWN = /goal|target|initial/;

type Stop = () => void;

/** When it was last told where the robot is, and how often that is promised (s). */
export interface Heard {
  timestamp: string;
  deadline: number | undefined;
}

/** What of a robot's resources the scene shows; follows them as they come and go. */
export class Sources {
  readonly #world: World;
  readonly #stops = new Map<string, Stop>();
  heard: Heard | undefined;

  /** The text that each description was drawn from. */
  readonly #described = new Map<string, [space: string, text: string]>();
  /** Services that return files of descriptions. */
  #assets: string[] = [];

  constructor(world: World) {
    this.#world = world;
    world.fetch = (path) => this.#fetch(parentOf(belowBranch(path)));
  }

  /** Watch what is new, and no more what is gone. */
  sync(resources: Resource[]): void {
    const assets = ofShape(resources, "assets").filter((one) => one.operations.includes("execute")).map((one) => one.path);
    const anew = assets.join() !== this.#assets.join();
    this.#assets = assets;
    const wanted = new Map(this.#wanted(resources.filter((one) => one.operations.includes("subscribe") && (one.kind === "sensor" || shapes(one).has("urdf")))));
    for (const [key, stop] of this.#stops) {
      if (wanted.has(key)) continue;
      stop();
      this.#stops.delete(key);
      const path = key.split(" ")[1] as string;
      this.#described.delete(path);
      this.#world.forget(path);
    }
    for (const [key, begin] of wanted) if (!this.#stops.has(key)) this.#stops.set(key, begin());
    if (anew) for (const [path, [space, text]] of this.#described) void this.#draw(space, path, text);
  }

  stop(): void {
    for (const stop of this.#stops.values()) stop();
    this.#stops.clear();
    this.#described.clear();
  }

  *#wanted(resources: Resource[]): Generator<[string, () => Stop]> {
    const world = this.#world;
    const stars = starsOf(resources);
    const spaces = [...new Set([...stars.map(spaceOf), ...ofShape(resources, "transforms").map((one) => parentOf(belowBranch(one.path)))])];
    const space = (path: string): string =>
      spaces.filter((one) => one === "" || belowBranch(path).startsWith(`${one}/`)).sort((a, b) => b.length - a.length)[0] ?? "";
    for (const [shape, layer, options] of DRAWN)
      for (const { path } of ofShape(resources, shape))
        yield [`${layer} ${path}`, () => watch(path, options, ({ body }) => world.take(layer, space(path), path, body))];
    for (const one of ofShape(resources, "markers")) {
      const options = properties(one).has("markers") ? FEW : MANY;
      yield [`markers ${one.path}`, () => watch(one.path, options, ({ body }) => world.take("markers", space(one.path), one.path, body))];
    }
    const grids = ofShape(resources, "grid").map(({ path }) => path);
    for (const path of grids) {
      const [layer, rate] = COSTS.test(path) ? (["costmap", 2] as const) : (["map", 0.5] as const);
      yield [`${layer} ${path}`, () => watch(path, { rate, ...BYTES }, ({ body }) => world.take(layer, space(path), path, body))];
    }
    for (const { path } of ofShape(resources, "gridUpdate")) {
      const whole = path.replace(UPDATES, "");
      if (grids.includes(whole)) yield [`update ${path}`, () => watch(path, { ...FEW, ...BYTES }, ({ body }) => world.patch(whole, body))];
    }
    for (const star of stars) yield [`frames ${star}`, () => watch(star, { rate: 20 }, ({ body }) => world.transforms(spaceOf(star), star, body))];
    for (const { path } of ofShape(resources, "transforms"))
      yield [`frames ${path}`, () => watch(path, { rate: 20 }, ({ body }) => world.transforms(space(path), path, body))];
    for (const { path } of ofShape(resources, "joints"))
      yield [`joints ${path}`, () => watch(path, { rate: 20 }, ({ body }) => world.joints(space(path), body))];
    const told = new Set<string>();
    for (const one of posesOf(resources)) {
      const { path } = one;
      const mine = space(path);
      if (!told.has(mine) && !NOT_ITS_OWN.test(path)) {
        told.add(mine);
        yield [`robot ${path}`, () => {
          const stop = watch(path, { rate: 30 }, ({ body, timestamp }) => {
            if (world.pose(mine, body)) this.heard = { timestamp, deadline: one.deadline };
          });
          return () => {
            stop();
            world.unposed(mine);
          };
        }];
      } else if (shapes(one).has("pose") && framed(one))
        yield [`pose ${path}`, () => watch(path, { rate: 5 }, ({ body }) => world.take("pose", mine, path, body))];
    }
    for (const ned of ofShape(resources, "ned")) {
      const mine = space(ned.path);
      const beside = parentOf(ned.path.replace(/\/position\/[^/]*$/, "/x"));
      const attitude = ofShape(resources, "attitude").find((one) => one.path.startsWith(`${beside}/`));
      if (!told.has(mine)) yield [`ned ${ned.path}`, () => flight(world, mine, ned.path, attitude?.path, (timestamp) => (this.heard = { timestamp, deadline: ned.deadline }))];
      told.add(mine);
    }
    for (const { path } of ofShape(resources, "urdf"))
      yield [`robot ${path}`, () => watch(path, {}, ({ body }) => void this.#describe(space(path), path, body))];
  }

  async #describe(space: string, path: string, body: any): Promise<void> {
    const text = typeof body === "string" ? body : body?.data;
    if (typeof text !== "string" || !text.includes("<robot") || this.#described.get(path)?.[1] === text) return;
    // The node that publishes it has it as a parameter, too.
    if ([...this.#described].some(([other, told]) => other !== path && told[0] === space && told[1] === text)) return;
    this.#described.set(path, [space, text]);
    await this.#draw(space, path, text);
  }

  async #draw(space: string, path: string, text: string): Promise<void> {
    const world = this.#world;
    try {
      const { modelOf } = await import("./model.ts");
      const made = await modelOf(text, this.#fetch(parentOf(belowBranch(path))), () => world.changed());
      if (this.#described.get(path)?.[1] !== text) return made.dispose();
      world.model(space, path, made);
      world.problem(path, undefined);
    } catch (error) {
      world.problem(path, `cannot be read: ${(error as Error).message}`);
    }
  }

  /** What gets the files of a description: the service that stands beside it. */
  #fetch(beside: string): Fetch | undefined {
    const service = this.#assets.find((one) => parentOf(parentOf(belowBranch(one))) === beside) ?? this.#assets[0];
    if (!service) return undefined;
    return async (uri) => bytesOf((await app.client.execute(service, { uri }).result).data);
  }
}

/** Whether its values say in which frame they are. */
const framed = (one: Resource): boolean => /"(frame_id|header)"/.test(JSON.stringify(one.schemas?.value ?? {}));

/** Where a robot is told to be: with its frame first, as a pose before odometry. */
export function posesOf(resources: Resource[]): Resource[] {
  const rank = (one: Resource): number => (framed(one) ? 0 : 2) + (shapes(one).has("pose") ? 0 : 1) + (NOT_ITS_OWN.test(one.path) ? 8 : 0);
  return [...new Set([...ofShape(resources, "pose"), ...ofShape(resources, "odometry")])]
    .filter((one) => one.kind === "sensor")
    .sort((a, b) => rank(a) - rank(b));
}

/**
 * Patterns of what tells where all frames are in one of them, as few as there are trees.
 *
 * In the robot's own frame most of them stand still, so that nothing needs to be sent.
 */
function starsOf(resources: Resource[]): string[] {
  const stars = new Map<string, Set<string>>();
  for (const { path } of ofShape(resources, "transform")) {
    const [base, source] = [parentOf(path), path.slice(path.lastIndexOf("/") + 1)];
    if (!stars.has(base)) stars.set(base, new Set());
    stars.get(base)!.add(source);
  }
  const rank = (base: string): number => (STARS.indexOf(base.slice(base.lastIndexOf("/") + 1)) + STARS.length + 1) % (STARS.length + 1);
  const chosen: string[] = [];
  const covered = new Set<string>();
  for (const [base, sources] of [...stars].sort(([a], [b]) => rank(a) - rank(b))) {
    const tree = parentOf(base);
    const own = [base.slice(base.lastIndexOf("/") + 1), ...sources].map((name) => `${tree} ${name}`);
    if (own.every((name) => covered.has(name))) continue;
    own.forEach((name) => covered.add(name));
    chosen.push(`${base}/*`);
  }
  return chosen;
}

const parentOf = (path: string): string => path.slice(0, Math.max(0, path.lastIndexOf("/")));
/** Without tenant and branch. */
const belowBranch = (path: string): string => path.split("/").slice(4).join("/");
/** What stands before `tf/<target>/*`. */
const spaceOf = (star: string): string => belowBranch(star).replace(/\/?tf\/[^/]+\/\*$/, "");

/** Follow a vehicle that tells place and attitude apart. */
function flight(world: World, space: string, place: string, attitude: string | undefined, hear: (timestamp: string) => void): Stop {
  let [at, turned]: any[] = [];
  const tell = (): boolean => {
    const pose = at && poseOfNed(at, turned);
    return pose !== undefined && world.posed(space, pose, true);
  };
  const stops = [
    watch(place, { rate: 20 }, ({ body, timestamp }) => {
      at = body;
      if (tell()) hear(timestamp);
    }),
  ];
  if (attitude)
    stops.push(
      watch(attitude, { rate: 20 }, ({ body }) => {
        turned = body;
        tell();
      }),
    );
  return () => {
    stops.forEach((stop) => stop());
    world.unposed(space);
  };
}
