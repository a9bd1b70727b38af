/** Many things of one kind that are drawn at once, made anew whenever one of them changes. */
import {
  BoxGeometry, BufferAttribute, BufferGeometry, ConeGeometry, CylinderGeometry, DoubleSide, Group, InstancedBufferAttribute, InstancedMesh, LineBasicMaterial, LineSegments, type Material, Matrix4, Mesh, MeshBasicMaterial,
  MeshLambertMaterial, type Object3D, Points as PointsObject, PointsMaterial, SphereGeometry,
} from "three";

import { discard } from "./discard.ts";
import type { Rgba } from "./markers.ts";

export type Solid = "box" | "ball" | "rod" | "tip" | "bar";
const DOT = 4; // pixels

const CROWD = 64; // from which on each is drawn with fewer corners

/** Each fills a cube of one metre, with so many corners around; what has an axis has it along z. */
const FORMS: Record<Solid, (around: number) => BufferGeometry> = {
  box: () => new BoxGeometry(1, 1, 1),
  ball: (around) => new SphereGeometry(0.5, around, around / 2),
  rod: (around) => new CylinderGeometry(0.5, 0.5, 1, around).rotateX(Math.PI / 2),
  tip: (around) => new ConeGeometry(0.5, 1, around).rotateX(Math.PI / 2),
  bar: () => new BoxGeometry(1, 1, 1),
};

/** Numbers that grow as they come. */
class Growing {
  data = new Float32Array(256);
  size = 0;

  push(from: ArrayLike<number>): void {
    const size = this.size + from.length;
    if (size > this.data.length) {
      const more = new Float32Array(Math.max(size, this.data.length * 2));
      more.set(this.data.subarray(0, this.size));
      this.data = more;
    }
    this.data.set(from, this.size);
    this.size = size;
  }
}

/** Solids of one form, each with its own place, size and colour. */
class Copies {
  object: InstancedMesh | undefined;
  readonly #parent: Group;
  readonly #form: Solid;
  readonly #clear: boolean;
  readonly #places = new Growing();
  readonly #colours = new Growing();

  constructor(parent: Group, form: Solid, clear: boolean) {
    this.#parent = parent;
    this.#form = form;
    this.#clear = clear;
  }

  begin(): void {
    this.#places.size = this.#colours.size = 0;
  }

  add(place: Matrix4, colour: ArrayLike<number>): void {
    this.#places.push(place.elements);
    this.#colours.push(colour);
  }

  end(): void {
    const count = this.#places.size / 16;
    if (count > (this.object?.instanceMatrix.count ?? 0)) this.#make(Math.ceil(count * 1.25));
    const made = this.object;
    if (!made) return;
    made.count = count;
    made.visible = count > 0;
    if (count === 0) return;
    (made.instanceMatrix.array as Float32Array).set(this.#places.data.subarray(0, count * 16));
    const colours = made.geometry.attributes["color"] as InstancedBufferAttribute;
    (colours.array as Float32Array).set(this.#colours.data.subarray(0, count * 4));
    made.instanceMatrix.needsUpdate = colours.needsUpdate = true;
  }

  #make(room: number): void {
    if (this.object) {
      this.#parent.remove(this.object);
      discard(this.object);
      this.object.dispose();
    }
    const form = FORMS[this.#form](room > CROWD ? 10 : 24);
    form.setAttribute("color", new InstancedBufferAttribute(new Float32Array(room * 4), 4));
    const look = { vertexColors: true, transparent: this.#clear, depthWrite: !this.#clear };
    // Lines have the colour that was asked for, from wherever the light comes.
    const material: Material = this.#form === "bar" ? new MeshBasicMaterial(look) : new MeshLambertMaterial(look);
    this.object = new InstancedMesh(form, material, room);
    this.object.frustumCulled = false;
    this.#parent.add(this.object);
  }
}

type Flat = "lines" | "dots" | "faces";

/** Lines, points or triangles, with a colour at each end. */
class Corners {
  readonly object: Object3D & { geometry: BufferGeometry };
  readonly #places = new Growing();
  readonly #colours = new Growing();
  #room = 0;

  constructor(parent: Group, kind: Flat, clear: boolean) {
    const look = { vertexColors: true, transparent: clear, depthWrite: !clear };
    const geometry = new BufferGeometry();
    if (kind === "lines") this.object = new LineSegments(geometry, new LineBasicMaterial(look));
    else if (kind === "dots") this.object = new PointsObject(geometry, new PointsMaterial({ ...look, size: DOT, sizeAttenuation: false }));
    else this.object = new Mesh(geometry, new MeshLambertMaterial({ ...look, side: DoubleSide, flatShading: true }));
    this.object.frustumCulled = false;
    parent.add(this.object);
  }

  begin(): void {
    this.#places.size = this.#colours.size = 0;
  }

  add(x: number, y: number, z: number, colour: ArrayLike<number>): void {
    this.#places.push([x, y, z]);
    this.#colours.push(colour);
  }

  end(): void {
    const count = this.#places.size / 3;
    this.object.visible = count > 0;
    const { geometry } = this.object;
    if (count > this.#room) {
      this.#room = Math.ceil(count * 1.25);
      geometry.dispose();
      geometry.setAttribute("position", new BufferAttribute(new Float32Array(this.#room * 3), 3));
      geometry.setAttribute("color", new BufferAttribute(new Float32Array(this.#room * 4), 4));
    }
    geometry.setDrawRange(0, count);
    if (count === 0) return;
    for (const [name, from] of [["position", this.#places], ["color", this.#colours]] as const) {
      const attribute = geometry.attributes[name] as BufferAttribute;
      (attribute.array as Float32Array).set(from.data.subarray(0, from.size));
      attribute.needsUpdate = true;
    }
  }
}

/** All that one source draws in a few calls; what can be seen through is drawn after the rest. */
export class Batches {
  readonly object = new Group();
  readonly #copies = new Map<string, Copies>();
  readonly #corners = new Map<string, Corners>();

  begin(): void {
    for (const one of [...this.#copies.values(), ...this.#corners.values()]) one.begin();
  }

  solid(form: Solid, place: Matrix4, colour: Rgba): void {
    if (colour[3] === 0) return;
    const clear = colour[3] < 1;
    const key = `${form} ${clear}`;
    let found = this.#copies.get(key);
    if (!found) this.#copies.set(key, (found = new Copies(this.object, form, clear)));
    found.add(place, colour);
  }

  corner(kind: Flat, x: number, y: number, z: number, colour: ArrayLike<number>, clear: boolean): void {
    const key = `${kind} ${clear}`;
    let found = this.#corners.get(key);
    if (!found) this.#corners.set(key, (found = new Corners(this.object, kind, clear)));
    found.add(x, y, z, colour);
  }

  end(): void {
    for (const one of [...this.#copies.values(), ...this.#corners.values()]) one.end();
  }

  dispose(): void {
    for (const { object } of this.#copies.values()) object?.dispose();
  }
}
