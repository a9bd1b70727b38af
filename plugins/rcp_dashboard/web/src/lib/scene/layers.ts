import {
  ArrowHelper, AxesHelper, BoxGeometry, BufferAttribute, BufferGeometry, type Camera, Color, ConeGeometry, CylinderGeometry, Group, Line, LineBasicMaterial, type Matrix4, Mesh,
  MeshBasicMaterial, MeshStandardMaterial, Points as PointsObject, PointsMaterial, RingGeometry, type Sprite, Vector3,
} from "three";

import type { Anchor, Wish } from "../labels.ts";
import { colour, type Colouring, type Points } from "./cloud.ts";
import { drawable, matrixOf } from "./frames.ts";
import { words } from "./words.ts";

const TRAIL = 4000; // places
const STEP = 0.03; // m between places of a trail

/** The robot where nothing says what it looks like: a body and a nose. */
export function body(): Group {
  const made = new Group();
  const base = new Mesh(new BoxGeometry(0.5, 0.4, 0.2), new MeshStandardMaterial({ color: 0x3d8ee6 }));
  base.position.z = 0.15;
  const nose = new Mesh(new ConeGeometry(0.14, 0.3, 20), new MeshStandardMaterial({ color: 0xffc04d }));
  nose.rotation.z = -Math.PI / 2;
  nose.position.set(0.34, 0, 0.16);
  made.add(base, nose);
  return made;
}

/** The same in the air: arms with rotors, those ahead in another colour. */
export function flyer(): Group {
  const made = new Group();
  const dark = new MeshStandardMaterial({ color: 0x39424e });
  made.add(new Mesh(new BoxGeometry(0.26, 0.18, 0.1), dark));
  for (const [x, y] of [[1, 1], [1, -1], [-1, 1], [-1, -1]] as const) {
    const arm = new Mesh(new BoxGeometry(0.36, 0.04, 0.03), dark);
    arm.position.set(0.14 * x, 0.14 * y, 0.02);
    arm.rotation.z = (Math.PI / 4) * x * y;
    const rotor = new Mesh(new CylinderGeometry(0.17, 0.17, 0.015, 24), new MeshStandardMaterial({ color: x > 0 ? 0xffa024 : 0x3d8ee6, transparent: true, opacity: 0.75 }));
    rotor.rotation.x = Math.PI / 2;
    rotor.position.set(0.26 * x, 0.26 * y, 0.06);
    made.add(arm, rotor);
  }
  return made;
}

/** A line from what is in the air to the ground below it, with a ring there. */
export class Drop {
  readonly object = new Group();
  readonly #line: Mesh;

  constructor() {
    const material = new MeshBasicMaterial({ color: 0x8a94a3 });
    this.#line = new Mesh(new CylinderGeometry(0.012, 0.012, 1, 6), material);
    this.#line.rotation.x = Math.PI / 2;
    this.object.add(this.#line, new Mesh(new RingGeometry(0.22, 0.27, 32), material));
    this.object.visible = false;
  }

  show(at: Vector3 | undefined): void {
    this.object.visible = at !== undefined && Math.abs(at.z) > HIGH;
    if (!at) return;
    this.object.position.set(at.x, at.y, 0.01);
    this.#line.position.z = at.z / 2;
    this.#line.scale.y = Math.abs(at.z);
  }
}

/** Metres from which on something is in the air. */
export const HIGH = 0.4;

/** Where it has been. */
export class Trail {
  readonly object: Line;
  #places = new Float32Array(TRAIL * 3);
  #count = 0;

  constructor() {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(this.#places, 3));
    geometry.setDrawRange(0, 0);
    this.object = new Line(geometry, new LineBasicMaterial({ color: 0xf0a13c }));
    this.object.frustumCulled = false;
  }

  get count(): number {
    return this.#count;
  }

  push(x: number, y: number, z: number): void {
    const last = (this.#count - 1) * 3;
    const before = this.#places.subarray(last, last + 3) as unknown as [number, number, number];
    if (this.#count > 0 && Math.hypot(x - before[0], y - before[1], z + 0.03 - before[2]) < STEP) return;
    if (this.#count === TRAIL) {
      this.#places.copyWithin(0, TRAIL * 1.5); // the older half goes
      this.#count = TRAIL / 2;
    }
    this.#places.set([x, y, z + 0.03], this.#count * 3);
    this.#show(this.#count + 1);
  }

  clear(): void {
    this.#show(0);
  }

  #show(count: number): void {
    this.#count = count;
    this.object.geometry.setDrawRange(0, count);
    this.object.geometry.attributes["position"]!.needsUpdate = true;
  }
}

/** Points that are all new with each message: a scan, a cloud. */
export class Dots {
  readonly object: PointsObject<BufferGeometry, PointsMaterial>;
  /** By what they are coloured. */
  by: Colouring = "plain";
  readonly #plain: Color;
  #room = 0;
  #points: Points = { places: new Float32Array(0), count: 0 };

  constructor(plain: number, size: number) {
    this.#plain = new Color(plain);
    this.object = new PointsObject(new BufferGeometry(), new PointsMaterial({ size, sizeAttenuation: false }));
    this.object.frustumCulled = false;
    this.object.matrixAutoUpdate = false;
  }

  get count(): number {
    return this.#points.count;
  }

  show(points: Points): void {
    this.#points = points;
    if (points.count * 3 > this.#room) {
      this.#room = Math.ceil(points.count * 1.25) * 3;
      this.object.geometry.dispose();
      this.object.geometry = new BufferGeometry();
      for (const name of ["position", "color"]) this.object.geometry.setAttribute(name, new BufferAttribute(new Float32Array(this.#room), 3));
    }
    const attribute = this.object.geometry.attributes["position"];
    if (attribute) {
      (attribute.array as Float32Array).set(points.places.subarray(0, points.count * 3));
      attribute.needsUpdate = true;
    }
    this.object.geometry.setDrawRange(0, points.count);
  }

  colour(wanted: Colouring, at: Matrix4): void {
    const attribute = this.object.geometry.attributes["color"];
    this.by = attribute ? colour(this.#points, wanted, at, attribute.array as Float32Array) : "plain";
    const each = this.by !== "plain";
    if (this.object.material.vertexColors !== each) {
      this.object.material.vertexColors = each;
      this.object.material.needsUpdate = true;
    }
    this.object.material.color.copy(each ? WHITE : this.#plain);
    if (attribute) attribute.needsUpdate = each;
  }

  /** The middle of all points, in their own frame. */
  middle(): Vector3 {
    const { places, count } = this.#points;
    const sum = [0, 0, 0] as [number, number, number];
    for (let i = 0; i < count * 3; i += 3) for (const axis of [0, 1, 2] as const) sum[axis] += places[i + axis] as number;
    return new Vector3(...sum).divideScalar(Math.max(1, count));
  }
}

const WHITE = new Color(0xffffff);

/** A way that is planned. */
export function pathLine(path: any): Line {
  const places: any[] = (path.poses ?? []).map((one: any) => one.pose?.position ?? one.position ?? one);
  const flat = new Float32Array(places.map((one) => [one.x ?? 0, one.y ?? 0, (one.z ?? 0) + 0.04]).filter((one) => drawable(...one)).flat());
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(flat, 3));
  const made = new Line(geometry, new LineBasicMaterial({ color: 0x3fbf7f }));
  made.frustumCulled = false;
  return made;
}

/** A pose that somebody tells of: an arrow along its x. */
export function poseArrow(position: any, orientation: any): ArrowHelper {
  const at = matrixOf(position, orientation);
  const along = new Vector3().setFromMatrixColumn(at, 0).normalize();
  return new ArrowHelper(along, new Vector3().setFromMatrixPosition(at), 0.8, 0xd065d8, 0.25, 0.16);
}

/** Where it is told to go: an arrow standing on the floor. */
export function goalMark(): Group {
  const made = new Group();
  const material = new MeshBasicMaterial({ color: 0x3fbf7f });
  const tip = new Mesh(new ConeGeometry(0.16, 0.45, 16), material);
  tip.rotation.z = -Math.PI / 2;
  tip.position.set(0.3, 0, 0.05);
  const foot = new Mesh(new BoxGeometry(0.3, 0.06, 0.06), material);
  foot.position.z = 0.05;
  made.add(tip, foot);
  return made;
}

/** Where a name is beside its place, in parts of its size. */
const SIDES: readonly Anchor[] = [[-0.05, -0.1], [-0.05, 1.1], [1.05, -0.1], [1.05, 1.1]];

/** A name beside a place, of one size however far away it is. */
export class Name {
  readonly object: Sprite;
  readonly #wide: number;

  constructor(name: string) {
    const made = words(name, "#1b2733", "#ffffff", { attenuated: false, above: true });
    this.object = made.object;
    this.#wide = made.wide;
    this.object.visible = false;
  }

  /** Write it so high. */
  fit(height: number): void {
    this.object.scale.set(height * this.#wide, height, 1);
  }

  /** What room it wants in the picture, in normalised device coordinates. */
  wish(key: string, camera: Camera): Wish {
    const { x, y } = new Vector3().setFromMatrixPosition(this.object.matrixWorld).project(camera);
    const [across, up] = [camera.projectionMatrix.elements[0] as number, camera.projectionMatrix.elements[5] as number];
    return { key, x, y, width: this.object.scale.x * across, height: this.object.scale.y * up };
  }

  /** Show it on a side of its place, or not at all. */
  stand(side: number | undefined): void {
    this.object.visible = side !== undefined;
    if (side !== undefined) this.object.center.set(...(SIDES[side] as [number, number]));
  }
}

/** The sides on which a name may be. */
export const sides = (): readonly Anchor[] => SIDES;

/** A frame: its axes, x red, y green, z blue, and its name. */
export class FrameMark {
  readonly object: AxesHelper;
  readonly name: Name;

  constructor(name: string, size = 0.3) {
    this.object = new AxesHelper(size);
    this.object.matrixAutoUpdate = false;
    this.name = new Name(name);
    this.object.add(this.name.object);
  }
}
