import {
  AxesHelper, BoxGeometry, BufferAttribute, BufferGeometry, ConeGeometry, DataTexture, Group, Line, LineBasicMaterial, LinearFilter, type Matrix4, Mesh,
  MeshBasicMaterial, MeshStandardMaterial, NearestFilter, PlaneGeometry, Points, PointsMaterial, RGBAFormat, SRGBColorSpace,
} from "three";

import { bytesOf } from "../picture.ts";
import { matrixOf } from "./frames.ts";

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
  made.matrixAutoUpdate = false;
  return made;
}

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

  push(x: number, y: number, z: number): void {
    const last = (this.#count - 1) * 3;
    if (this.#count > 0 && Math.hypot(x - this.#places[last]!, y - this.#places[last + 1]!) < STEP) return;
    if (this.#count === TRAIL) {
      this.#places.copyWithin(0, TRAIL * 1.5); // the older half goes
      this.#count = TRAIL / 2;
    }
    this.#places.set([x, y, z + 0.03], this.#count * 3);
    this.#count += 1;
    this.object.geometry.setDrawRange(0, this.#count);
    this.object.geometry.attributes["position"]!.needsUpdate = true;
  }
}

/** Points that are all new with each message: a scan, a cloud. */
export class Dots {
  readonly object: Points;
  #room = 0;

  constructor(colour: number, size: number) {
    this.object = new Points(new BufferGeometry(), new PointsMaterial({ color: colour, size, sizeAttenuation: false }));
    this.object.frustumCulled = false;
    this.object.matrixAutoUpdate = false;
  }

  show(places: Float32Array, count: number, at: Matrix4): void {
    if (count * 3 > this.#room) {
      this.#room = Math.ceil(count * 1.25) * 3;
      this.object.geometry.dispose();
      this.object.geometry = new BufferGeometry();
      this.object.geometry.setAttribute("position", new BufferAttribute(new Float32Array(this.#room), 3));
    }
    const attribute = this.object.geometry.attributes["position"];
    if (attribute) {
      (attribute.array as Float32Array).set(places.subarray(0, count * 3));
      attribute.needsUpdate = true;
    }
    this.object.geometry.setDrawRange(0, count);
    this.object.matrix.copy(at);
  }
}

/** The ends of the beams that came back, in the scanner's frame. */
export function scanPoints(scan: any): { places: Float32Array; count: number } {
  const places = new Float32Array(scan.ranges.length * 3);
  let count = 0;
  for (let at = 0; at < scan.ranges.length; at++) {
    const range = scan.ranges[at];
    if (typeof range !== "number" || range < scan.range_min || range > scan.range_max) continue;
    const angle = scan.angle_min + at * scan.angle_increment;
    places[count * 3] = range * Math.cos(angle);
    places[count * 3 + 1] = range * Math.sin(angle);
    places[count * 3 + 2] = 0.1;
    count += 1;
  }
  return { places, count };
}

const MOST = 200_000; // points of a cloud that are drawn

/** Points of a `PointCloud2`, or of a plain list. */
export function cloudPoints(cloud: any): { places: Float32Array; count: number } {
  if (Array.isArray(cloud.points)) {
    const list = cloud.points.slice(0, MOST);
    const flat = Float32Array.from(list.flatMap((one: any) => (Array.isArray(one) ? one.slice(0, 3) : [one.x, one.y, one.z ?? 0])));
    return { places: flat, count: list.length };
  }
  const data = bytesOf(cloud.data);
  const view = new DataView(data.buffer);
  const offset = (name: string): number => cloud.fields.find((field: any) => field.name === name)?.offset ?? -1;
  const [x, y, z] = [offset("x"), offset("y"), offset("z")];
  const little = !cloud.is_bigendian;
  const total = Math.floor(data.length / cloud.point_step);
  const stride = Math.ceil(total / MOST);
  const places = new Float32Array(Math.ceil(total / stride) * 3);
  let count = 0;
  for (let at = 0; at < total; at += stride) {
    const from = at * cloud.point_step;
    const px = view.getFloat32(from + x, little);
    if (Number.isNaN(px)) continue;
    places[count * 3] = px;
    places[count * 3 + 1] = view.getFloat32(from + y, little);
    places[count * 3 + 2] = z < 0 ? 0 : view.getFloat32(from + z, little);
    count += 1;
  }
  return { places, count };
}

/** A map in cells, as a picture on the floor: free is light, occupied dark, unknown not there. */
export function gridMesh(grid: any, dark: boolean): Mesh {
  const { resolution, width, height, origin } = grid.info ?? grid;
  const cells: ArrayLike<number> = typeof grid.data === "string" ? bytesOf(grid.data) : grid.data;
  const pixels = new Uint8Array(width * height * 4);
  const [free, full] = dark ? [46, 205] : [255, 40];
  for (let at = 0, to = 0; at < width * height; at++, to += 4) {
    const cell = cells[at] as number;
    if (cell < 0 || cell > 100) continue;
    const shade = free + ((full - free) * cell) / 100;
    pixels[to] = pixels[to + 1] = pixels[to + 2] = shade;
    pixels[to + 3] = cell === 0 ? 200 : 255;
  }
  const texture = new DataTexture(pixels, width, height, RGBAFormat);
  texture.colorSpace = SRGBColorSpace;
  texture.magFilter = NearestFilter;
  texture.minFilter = LinearFilter;
  texture.needsUpdate = true;
  const made = new Mesh(new PlaneGeometry(width * resolution, height * resolution), new MeshBasicMaterial({ map: texture, transparent: true }));
  made.geometry.translate((width * resolution) / 2, (height * resolution) / 2, -0.01);
  made.matrixAutoUpdate = false;
  made.matrix.copy(matrixOf(origin?.position, origin?.orientation));
  return made;
}

/** A way that is planned. */
export function pathLine(path: any): Line {
  const places = (path.poses ?? []).map((one: any) => one.pose?.position ?? one.position ?? one);
  const flat = new Float32Array(places.flatMap((one: any) => [one.x ?? 0, one.y ?? 0, (one.z ?? 0) + 0.04]));
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(flat, 3));
  return new Line(geometry, new LineBasicMaterial({ color: 0x3fbf7f }));
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

export function axes(size: number): AxesHelper {
  const made = new AxesHelper(size);
  made.matrixAutoUpdate = false;
  return made;
}
