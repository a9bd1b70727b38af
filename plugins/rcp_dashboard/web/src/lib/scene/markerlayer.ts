import { Group, Matrix4, MeshPhongMaterial, type Object3D, Quaternion, Vector3 } from "three";

import { amount } from "../format.ts";
import { many } from "../words.ts";
import { Batches, type Solid } from "./batches.ts";
import { discard } from "./discard.ts";
import { type Marker, Markers } from "./markers.ts";
import type { Fetch, Meshes } from "./meshes.ts";
import { words, type Words } from "./words.ts";

const MOST_TEXTS = 300;
const MOST_MESHES = 100;
const THICK = 20_000; // ends of lines up to which these have their width, and are no hair lines
const LEAST = 40; // ms until the next marker is looked at that ends

/** What takes points of a frame into the fixed one; undefined where nothing tells. */
type Place = (frame: string) => Matrix4 | undefined;

/** A marker that is a thing of its own, and what it was made of. */
interface Single {
  from: string;
  object: Object3D;
}

/** The markers of one source, in the fixed frame. */
export class MarkerLayer {
  readonly object = new Group();
  readonly hidden = new Set<string>();
  /** Told when something of it has changed by itself. */
  readonly #changed: () => void;
  readonly #fetch: () => Fetch | undefined;
  readonly #now: () => number;
  readonly #store = new Markers();
  readonly #batches = new Batches();
  readonly #singles = new Map<string, Single>();
  /** Where the frame of each marker was when it was placed. */
  readonly #bases = new Map<string, Matrix4>();
  /** Where the frames of those were that move with them. */
  readonly #seen = new Map<string, string>();
  readonly #lost = new Map<string, number>();
  #dirty = true;
  #sum = new Vector3();
  #drawn = 0;
  #timer: ReturnType<typeof setTimeout> | undefined;
  #meshes: Promise<Meshes> | undefined;
  #meshProblems: ReadonlyMap<string, string> = new Map();
  #tooMany = "";

  constructor(changed: () => void, fetch: () => Fetch | undefined, now: () => number) {
    this.#changed = changed;
    this.#fetch = fetch;
    this.#now = now;
    this.object.add(this.#batches.object);
  }

  take(value: any): void {
    for (const key of this.#store.take(value, this.#now())) this.#bases.delete(key);
    this.#dirty = true;
  }

  clear(): void {
    this.#store.clear();
    this.#dirty = true;
  }

  get count(): number {
    return this.#store.all.size;
  }

  /** How many are no texts. */
  get things(): number {
    return [...this.#store.all.values()].filter(({ kind }) => kind !== "text").length;
  }

  /** The middle of all that is drawn; undefined where nothing is. */
  get middle(): Vector3 | undefined {
    return this.#drawn > 0 ? this.#sum.clone().divideScalar(this.#drawn) : undefined;
  }

  /** The frames that the markers are told in. */
  get frames(): string[] {
    return [...new Set([...this.#store.all.values()].map((one) => one.frame))];
  }

  /** The namespaces, each with how many markers it has. */
  get namespaces(): Map<string, number> {
    const found = new Map<string, number>();
    for (const { ns } of this.#store.all.values()) found.set(ns, (found.get(ns) ?? 0) + 1);
    return found;
  }

  problems(fixed: string): string[] {
    const lost = [...this.#lost].map(([frame, count]) => `no transform from ${frame || "the robot"} to ${fixed} (${amount(count)} ${count === 1 ? "marker" : "markers"})`);
    return [...lost, ...this.#store.problems, ...(this.#tooMany ? [this.#tooMany] : []), ...[...this.#meshProblems].map(([uri, why]) => `${uri}: ${why}`)];
  }

  show(ns: string, visible: boolean): void {
    if (visible) this.hidden.delete(ns);
    else this.hidden.add(ns);
    this.#dirty = true;
  }

  /** Put all where they belong; where the fixed frame is another one, all are placed anew. */
  settle(place: Place, anew: boolean): void {
    if (anew) this.#bases.clear();
    if (this.#store.expire(this.#now())) this.#dirty = true;
    if (this.#follow(place) || anew || this.#dirty) this.#build(place);
    this.#dirty = false;
    clearTimeout(this.#timer);
    const { next } = this.#store;
    if (next < Infinity) this.#timer = setTimeout(this.#changed, Math.max(LEAST, next - this.#now()));
  }

  /** Whether a frame that markers move with, or wait for, is somewhere else now. */
  #follow(place: Place): boolean {
    let moved = false;
    const looked = new Set<string>();
    for (const { key, frame, locked } of this.#store.all.values()) {
      if ((!locked && this.#bases.has(key)) || looked.has(frame)) continue;
      looked.add(frame);
      const at = place(frame)?.elements.join() ?? "";
      if (this.#seen.get(frame) !== at) moved = true;
      this.#seen.set(frame, at);
    }
    return moved;
  }

  #build(place: Place): void {
    const now = new Map<string, Matrix4 | undefined>();
    const at = (frame: string): Matrix4 | undefined => {
      if (!now.has(frame)) now.set(frame, place(frame));
      return now.get(frame);
    };
    for (const key of this.#bases.keys()) if (!this.#store.all.has(key)) this.#bases.delete(key);
    const { all } = this.#store;
    const singles = new Set<string>();
    let [texts, meshes] = [0, 0];
    const thick = [...all.values()].reduce((sum, one) => sum + (one.kind.startsWith("line") ? one.points.length / 3 : 0), 0) <= THICK;
    this.#lost.clear();
    this.#sum.set(0, 0, 0);
    this.#drawn = 0;
    this.#batches.begin();
    for (const one of all.values()) {
      const base = (one.locked ? undefined : this.#bases.get(one.key)) ?? at(one.frame);
      if (!base) {
        this.#lost.set(one.frame, (this.#lost.get(one.frame) ?? 0) + 1);
        continue;
      }
      if (!one.locked) this.#bases.set(one.key, base);
      if (this.hidden.has(one.ns)) continue;
      const pose = new Matrix4().multiplyMatrices(base, one.pose);
      if (one.kind === "text" || one.kind === "mesh") {
        const few = one.kind === "text" ? ++texts <= MOST_TEXTS : ++meshes <= MOST_MESHES;
        if (few) singles.add(one.key);
        if (few) this.#single(one, pose);
      } else this.#many(one, pose, thick);
      if (one.points.length === 0) this.#count(new Vector3().setFromMatrixPosition(pose));
    }
    this.#batches.end();
    for (const [key, single] of this.#singles) if (!singles.has(key)) this.#remove(key, single);
    this.#tooMany = [texts > MOST_TEXTS && `${many(texts - MOST_TEXTS, "text is", "texts are")} not drawn: ${MOST_TEXTS} is the most`, meshes > MOST_MESHES && `${many(meshes - MOST_MESHES, "mesh is", "meshes are")} not drawn: ${MOST_MESHES} is the most`].filter(Boolean).join("\n");
  }

  #count(at: Vector3): void {
    this.#sum.add(at);
    this.#drawn += 1;
  }

  #many(one: Marker, pose: Matrix4, thick: boolean): void {
    const { kind, scale, colour } = one;
    if (kind === "cube" || kind === "sphere" || kind === "cylinder") return this.#batches.solid(SOLIDS[kind], pose.scale(scale), colour);
    if (kind === "arrow" && one.points.length === 0) {
      const [from, along] = [new Vector3().setFromMatrixPosition(pose), new Vector3().setFromMatrixColumn(pose, 0)];
      return this.#arrow(from, from.clone().addScaledVector(along, scale.x), Math.max(scale.y, scale.z), 2 * Math.max(scale.y, scale.z), 0, one);
    }
    const ends = pointsIn(one, kind === "triangles" ? new Matrix4().copy(pose).scale(scale) : pose);
    for (const end of ends) if (end) this.#count(end.at);
    if (kind === "arrow" || kind === "arrow strip") {
      for (let at = 1; at < ends.length; at++) {
        const [from, to] = [ends[at - 1], ends[at]];
        if (from && to) this.#arrow(from.at, to.at, scale.x, scale.y, scale.z, one);
      }
    } else if (kind === "cube list" || kind === "sphere list") {
      const turned = new Quaternion().setFromRotationMatrix(pose);
      for (const end of ends) if (end) this.#batches.solid(kind === "cube list" ? "box" : "ball", new Matrix4().compose(end.at, turned, scale), end.colour);
    } else if (kind === "points") {
      for (const end of ends) if (end) this.#corner("dots", end, one);
    } else if (kind === "triangles") {
      for (let at = 0; at + 2 < ends.length; at += 3) {
        const three = ends.slice(at, at + 3);
        if (three.every((end) => end !== undefined)) for (const end of three) this.#corner("faces", end as End, one);
      }
    } else {
      for (let at = 1; at < ends.length; at += kind === "line list" ? 2 : 1) {
        const [from, to] = [ends[at - 1], ends[at]];
        if (!from || !to) continue;
        // However far away it is, a line is as thick as a pixel.
        for (const end of [from, to]) this.#corner("lines", end, one);
        if (thick) this.#batches.solid("bar", along(from.at, to.at, scale.x), from.colour);
      }
    }
  }

  #corner(kind: "lines" | "dots" | "faces", { at, colour }: End, { colours, colour: own }: Marker): void {
    this.#batches.corner(kind, at.x, at.y, at.z, colour, colours !== undefined || own[3] < 1);
  }

  /** Draw an arrow of a shaft and a head as RViz does: without a length the head is 0.23 of all. */
  #arrow(from: Vector3, to: Vector3, shaft: number, head: number, length: number, { colour }: Marker): void {
    const whole = from.distanceTo(to);
    if (whole === 0) return;
    const neck = from.clone().lerp(to, 1 - Math.min(1, (length || 0.23 * whole) / whole));
    if (neck.distanceTo(from) > 0) this.#batches.solid("rod", along(from, neck, shaft), colour);
    this.#batches.solid("tip", along(neck, to, head), colour);
  }

  #single(one: Marker, pose: Matrix4): void {
    const from = one.kind === "text" ? `${one.text} ${one.colour}` : `${one.mesh} ${one.embedded} ${one.colour}`;
    let found = this.#singles.get(one.key);
    if (found?.from !== from) {
      if (found) this.#remove(one.key, found);
      found = { from, object: one.kind === "text" ? textOf(one) : this.#mesh(one) };
      this.#singles.set(one.key, found);
      this.object.add(found.object);
    }
    if (one.kind === "text") {
      const { wide, lines } = found.object.userData as Pick<Words, "wide" | "lines">;
      found.object.position.setFromMatrixPosition(pose);
      found.object.scale.set(one.scale.z * 1.4 * wide, one.scale.z * 1.4 * lines, 1);
    } else found.object.matrix.copy(pose).scale(one.scale);
    found.object.matrixWorldNeedsUpdate = true;
  }

  #mesh({ mesh, embedded, colour: [r, g, b, a] }: Marker): Object3D {
    const made = new Group();
    made.matrixAutoUpdate = false;
    const material = new MeshPhongMaterial({ transparent: a < 1, opacity: a });
    material.color.setRGB(r, g, b);
    this.#meshes ??= import("./meshes.ts").then(({ Meshes: Known }) => {
      const found = new Known(this.#fetch());
      found.manager.onLoad = this.#changed;
      this.#meshProblems = found.problems;
      return found;
    });
    void this.#meshes
      .then((known) => known.load(mesh, material))
      .then((loaded) => {
        if (!embedded)
          loaded.traverse((part: any) => {
            if (part.isMesh && !part.material?.wireframe) part.material = material; // that of a box in place of a mesh stays
          });
        made.add(loaded);
        this.#changed();
      });
    return made;
  }

  #remove(key: string, { object }: Single): void {
    this.object.remove(object);
    discard(object);
    this.#singles.delete(key);
  }

  dispose(): void {
    clearTimeout(this.#timer);
    this.#batches.dispose();
    void this.#meshes?.then((known) => known.dispose());
  }
}

const SOLIDS: Record<"cube" | "sphere" | "cylinder", Solid> = { cube: "box", sphere: "ball", cylinder: "rod" };

interface End {
  at: Vector3;
  colour: Marker["colour"];
}

/** The points of a marker in the fixed frame with their colours; undefined for those that are no numbers. */
function pointsIn({ points, colours, colour }: Marker, pose: Matrix4): (End | undefined)[] {
  const made: (End | undefined)[] = [];
  for (let at = 0; at < points.length / 3; at++) {
    const place = new Vector3().fromArray(points, at * 3);
    if (Number.isNaN(place.x)) made.push(undefined);
    else made.push({ at: place.applyMatrix4(pose), colour: colours ? ([...colours.subarray(at * 4, at * 4 + 4)] as Marker["colour"]) : colour });
  }
  return made;
}

const UP = new Vector3(0, 0, 1);

/** What takes something one metre long along z between two places, so thick. */
function along(from: Vector3, to: Vector3, thick: number): Matrix4 {
  const way = to.clone().sub(from);
  const long = way.length();
  const turned = new Quaternion().setFromUnitVectors(UP, long > 0 ? way.divideScalar(long) : UP);
  return new Matrix4().compose(from.clone().lerp(to, 0.5), turned, new Vector3(thick, thick, long));
}

function textOf({ text, colour: [r, g, b, a] }: Marker): Object3D {
  const light = 0.2126 * r + 0.7152 * g + 0.0722 * b > 0.18;
  const shade = (one: number): number => Math.round(255 * (one <= 0.0031308 ? one * 12.92 : 1.055 * one ** (1 / 2.4) - 0.055));
  const made = words(text || " ", `rgb(${shade(r)} ${shade(g)} ${shade(b)})`, light ? "#10151b" : "#ffffff", { attenuated: true, above: false, opacity: a });
  const { object, wide, lines } = made;
  object.userData = { wide, lines };
  return object;
}
