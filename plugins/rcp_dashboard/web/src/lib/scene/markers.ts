import { type Matrix4, Vector3 } from "three";

import { amount } from "../format.ts";
import { many } from "../words.ts";
import { drawable, matrixOf } from "./frames.ts";

export const MOST = 5000; // markers of one source that are drawn
export const MOST_POINTS = 100_000; // points of all markers of one source

/** By the numbers that `visualization_msgs/Marker` gives them. */
const KINDS = ["arrow", "cube", "sphere", "cylinder", "line strip", "line list", "cube list", "sphere list", "points", "text", "mesh", "triangles", "arrow strip"] as const;
export type Kind = (typeof KINDS)[number];
const LISTS: ReadonlySet<Kind> = new Set<Kind>(["line strip", "line list", "cube list", "sphere list", "points", "triangles", "arrow strip"]);
/** The parts of `scale` that must not be zero. */
const SIZES: Record<Kind, string> = {
  arrow: "xyz", cube: "xyz", sphere: "xyz", cylinder: "xyz", "line strip": "x", "line list": "x", "cube list": "xyz", "sphere list": "xyz", points: "x", text: "z", mesh: "xyz", triangles: "xyz", "arrow strip": "xy",
};
const LONGEST = 400; // letters of a text
const DELETE = 2;
const DELETE_ALL = 3;

export type Rgba = [red: number, green: number, blue: number, alpha: number];

/** A marker that can be drawn. */
export interface Marker {
  key: string;
  ns: string;
  kind: Kind;
  frame: string;
  /** Whether it moves with its frame; otherwise it stays where it was in the fixed frame when it came. */
  locked: boolean;
  /** Its pose in its frame. */
  pose: Matrix4;
  scale: Vector3;
  /** In linear colours. */
  colour: Rgba;
  points: Float32Array;
  /** Of each point, four numbers. */
  colours: Float32Array | undefined;
  text: string;
  mesh: string;
  /** Whether the mesh is drawn in its own colours. */
  embedded: boolean;
  /** When it is removed, ms; infinity if never. */
  ends: number;
  /** What of it is not drawn as it was told, and why. */
  notes: string[];
}

/** Markers of one source: kept until they are replaced or deleted, or their time is over. */
export class Markers {
  readonly #all = new Map<string, Marker>();
  readonly #refused = new Map<string, string>();
  readonly #left = new Set<string>();
  #points = 0;

  get all(): ReadonlyMap<string, Marker> {
    return this.#all;
  }

  /** When the next one ends, ms; infinity if none does. */
  get next(): number {
    let found = Infinity;
    for (const { ends } of this.#all.values()) found = Math.min(found, ends);
    return found;
  }

  /** Take a message with one marker or many, that came at a time in ms; returns the keys of those that are new or changed. */
  take(value: any, now: number): string[] {
    const list = value?.markers ?? [value];
    if (!Array.isArray(list)) throw new Error("it has no markers");
    const changed: string[] = [];
    for (const one of list) {
      const key = `${one?.ns ?? ""}/${one?.id ?? 0}`;
      const action = one?.action ?? 0;
      if (action === DELETE_ALL) this.#clear(String(one?.ns ?? ""));
      else if (action === DELETE) this.#drop(key);
      else if (action === 0 || action === 1) this.#put(key, one, now, changed);
      else this.#refuse(key, `unknown action ${action}`);
    }
    return changed;
  }

  #put(key: string, told: any, now: number, changed: string[]): void {
    this.#drop(key);
    if (this.#all.size >= MOST) {
      if (this.#left.size < 10 * MOST) this.#left.add(key);
      return;
    }
    try {
      const made = markerOf(key, told, now, MOST_POINTS - this.#points);
      this.#points += made.points.length / 3;
      this.#all.set(key, made);
      changed.push(key);
    } catch (error) {
      this.#refuse(key, (error as Error).message);
    }
  }

  #refuse(key: string, why: string): void {
    this.#drop(key);
    if (this.#refused.size < MOST) this.#refused.set(key, why);
  }

  #drop(key: string): void {
    const known = this.#all.get(key);
    if (known) this.#points -= known.points.length / 3;
    this.#all.delete(key);
    this.#refused.delete(key);
    this.#left.delete(key);
  }

  /** All, or those of a namespace (visualization_msgs/Marker). */
  #clear(namespace: string): void {
    if (namespace === "") return this.clear();
    const keys = [...this.#all.keys(), ...this.#refused.keys(), ...this.#left];
    for (const key of keys) if (key.slice(0, key.lastIndexOf("/")) === namespace) this.#drop(key);
  }

  clear(): void {
    this.#all.clear();
    this.#refused.clear();
    this.#left.clear();
    this.#points = 0;
  }

  /** Remove those whose time is over; returns whether there were any. */
  expire(now: number): boolean {
    let found = false;
    for (const [key, { ends }] of this.#all) {
      if (ends > now) continue;
      this.#drop(key);
      found = true;
    }
    return found;
  }

  /** What is not drawn, or not as it was told: each reason once, with how many markers it is about. */
  get problems(): string[] {
    const reasons = new Map<string, string[]>();
    const add = (why: string, key: string): unknown => (reasons.has(why) ? reasons.get(why)!.push(key) : reasons.set(why, [key]));
    for (const [key, why] of this.#refused) add(`not drawn: ${why}`, key);
    for (const { key, notes } of this.#all.values()) for (const why of notes) add(why, key);
    const made = [...reasons].map(([why, keys]) => `${keys[0]}${keys.length > 1 ? ` and ${amount(keys.length - 1)} more` : ""}: ${why}`);
    if (this.#left.size > 0) made.unshift(`${many(this.#left.size, "marker is", "markers are")} not drawn: ${amount(MOST)} is the most`);
    return made;
  }
}

function markerOf(key: string, told: any, now: number, room: number): Marker {
  const kind = KINDS[told?.type ?? -1];
  if (kind === undefined) throw new Error(`unknown type ${String(told?.type).slice(0, 40)}`);
  const notes: string[] = [];
  const scale = scaleOf(kind, told);
  const colour = colourOf(told.color);
  const { points, colours } = pointsOf(kind, told, room, notes);
  const transparent = colours ? false : colour[3] === 0;
  const embedded = told.mesh_use_embedded_materials === true;
  if (transparent && !(kind === "mesh" && embedded)) notes.push("it is fully transparent: its colour has alpha 0");
  const mesh = String(told.mesh_resource ?? "");
  if (kind === "mesh" && !mesh) throw new Error("it names no mesh_resource");
  const { sec = 0, nanosec = 0 } = told.lifetime ?? {};
  const lifetime = Number(sec) * 1000 + Number(nanosec) / 1e6;
  return {
    key,
    ns: String(told.ns ?? ""),
    kind,
    frame: String(told.header?.frame_id ?? told.frame_id ?? ""),
    locked: told.frame_locked === true,
    pose: matrixOf(told.pose?.position, told.pose?.orientation),
    scale,
    colour,
    points,
    colours,
    text: String(told.text ?? "").slice(0, LONGEST),
    mesh,
    embedded,
    ends: lifetime > 0 ? now + lifetime : Infinity,
    notes,
  };
}

function scaleOf(kind: Kind, told: any): Vector3 {
  const { x = 0, y = 0, z = 0 } = told.scale ?? {};
  if (!drawable(x, y, z)) throw new Error("its scale has something that is not a number, or is too large");
  if (Math.min(x, y, z) < 0) throw new Error("its scale is negative");
  const wanted = kind === "arrow" && told.points?.length ? "xy" : SIZES[kind];
  const zero = [...wanted].filter((axis) => ({ x, y, z })[axis] === 0);
  if (zero.length > 0) throw new Error(`its scale is zero in ${zero.join(", ")}`);
  return new Vector3(x, y, z);
}

/** A colour of the wire, as the graphics card reckons with it. */
export function colourOf(told: any): Rgba {
  const { r = 0, g = 0, b = 0, a = 0 } = told ?? {};
  if (![r, g, b, a].every(Number.isFinite)) throw new Error("its colour has something that is not a number");
  return [linear(r), linear(g), linear(b), Math.min(1, Math.max(0, a))];
}

function linear(value: number): number {
  const one = Math.min(1, Math.max(0, value));
  return one <= 0.04045 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4;
}

/** How many points make one thing, and how many colours it may have. */
const STRIDE: Partial<Record<Kind, number>> = { "line list": 2, triangles: 3 };

function pointsOf(kind: Kind, told: any, room: number, notes: string[]): Pick<Marker, "points" | "colours"> {
  const none = { points: new Float32Array(0), colours: undefined };
  const list = told.points ?? undefined;
  if (kind === "arrow" && !list?.length) return none;
  if (!LISTS.has(kind) && kind !== "arrow") return none;
  if (!Array.isArray(list)) throw new Error("it has no points");
  if (kind === "arrow" && list.length !== 2) throw new Error(`an arrow has 2 points or none, and this has ${list.length}`);
  const stride = STRIDE[kind] ?? 1;
  if (list.length % stride > 0) throw new Error(`the number of its points, ${list.length}, is no multiple of ${stride}`);
  const most = Math.min(list.length, Math.max(0, Math.floor(room / stride) * stride));
  if (most < list.length) notes.push(`${amount(most)} of ${amount(list.length)} points are drawn: ${amount(MOST_POINTS)} of all markers is the most`);
  const given = Array.isArray(told.colors) && told.colors.length > 0 ? told.colors : undefined;
  const each = given && (given.length === list.length ? 1 : kind === "triangles" && given.length * 3 === list.length ? 3 : 0);
  if (each === 0) notes.push(`${given.length} colours do not fit ${list.length} points: its own colour is used`);
  const points = new Float32Array(most * 3);
  const colours = each ? new Float32Array(most * 4) : undefined;
  let wrong = 0;
  for (let at = 0; at < most; at++) {
    const { x, y, z = 0 } = list[at] ?? {};
    const good = drawable(x, y, z);
    if (!good) wrong += 1;
    points.set(good ? [x, y, z] : [NaN, NaN, NaN], at * 3);
    if (colours) colours.set(colourOf(given[Math.floor(at / (each as number))]), at * 4);
  }
  if (wrong > 0) notes.push(`${wrong === 1 ? "a point that is no number is" : `${amount(wrong)} points that are no numbers are`} left out`);
  return { points, colours };
}
