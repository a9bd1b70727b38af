import { Color, type Matrix4 } from "three";

import { bytesOf, viewOf } from "../bytes.ts";

export type Colouring = "auto" | "rgb" | "intensity" | "height" | "plain";
export const COLOURINGS: Colouring[] = ["auto", "rgb", "intensity", "height", "plain"];
const MOST = 200_000; // points of a cloud that are drawn

/** Points in the frame of who measured them, with what their colour may tell. */
export interface Points {
  places: Float32Array;
  count: number;
  /** Packed red, green, blue. */
  rgb?: Uint8Array;
  intensity?: Float32Array;
}

type Reader = (view: DataView, at: number, little: boolean) => number;
const READERS: Record<number, Reader> = {
  1: (view, at) => view.getInt8(at),
  2: (view, at) => view.getUint8(at),
  3: (view, at, little) => view.getInt16(at, little),
  4: (view, at, little) => view.getUint16(at, little),
  5: (view, at, little) => view.getInt32(at, little),
  6: (view, at, little) => view.getUint32(at, little),
  7: (view, at, little) => view.getFloat32(at, little),
  8: (view, at, little) => view.getFloat64(at, little),
};

interface Field {
  offset: number;
  read: Reader;
}

function fieldOf(cloud: any, ...names: string[]): Field | undefined {
  const found = cloud.fields.find((one: any) => names.includes(one.name));
  const read = found && READERS[found.datatype];
  return read && { offset: found.offset, read };
}

/** Points of a `PointCloud2`, or of a plain list; places that are no numbers are left out. */
export function cloudPoints(cloud: any): Points {
  if (Array.isArray(cloud.points)) return listed(cloud.points);
  const data = bytesOf(cloud.data);
  const view = viewOf(data);
  const little = !cloud.is_bigendian;
  const [x, y, z] = [fieldOf(cloud, "x"), fieldOf(cloud, "y"), fieldOf(cloud, "z")];
  if (!x || !y) throw new Error("it has no fields x and y");
  const rgb = cloud.fields.find((one: any) => one.name === "rgb" || one.name === "rgba");
  const intensity = fieldOf(cloud, "intensity", "i", "reflectivity");
  const step = cloud.point_step;
  const row = cloud.row_step || cloud.width * step;
  const total = Math.min(cloud.width * cloud.height, Math.floor(data.length / step));
  const stride = Math.max(1, Math.ceil(total / MOST));
  const room = Math.ceil(total / stride);
  const made: Points = { places: new Float32Array(room * 3), count: 0 };
  if (rgb) made.rgb = new Uint8Array(room * 3);
  if (intensity) made.intensity = new Float32Array(room);
  for (let at = 0; at < total; at += stride) {
    const from = Math.floor(at / cloud.width) * row + (at % cloud.width) * step;
    const px = x.read(view, from + x.offset, little);
    const py = y.read(view, from + y.offset, little);
    const pz = z ? z.read(view, from + z.offset, little) : 0;
    if (!Number.isFinite(px + py + pz)) continue;
    const to = made.count * 3;
    made.places[to] = px;
    made.places[to + 1] = py;
    made.places[to + 2] = pz;
    if (rgb) {
      const packed = view.getUint32(from + rgb.offset, little);
      made.rgb![to] = packed >> 16;
      made.rgb![to + 1] = packed >> 8;
      made.rgb![to + 2] = packed;
    }
    if (intensity) made.intensity![made.count] = intensity.read(view, from + intensity.offset, little);
    made.count += 1;
  }
  return made;
}

function listed(points: any[]): Points {
  const count = Math.min(points.length, MOST);
  const places = new Float32Array(count * 3);
  for (let at = 0; at < count; at++) {
    const one = points[at];
    places.set(Array.isArray(one) ? one.slice(0, 3) : [one.x, one.y, one.z ?? 0], at * 3);
  }
  return { places, count };
}

/** The ends of the beams that came back, in the scanner's frame. */
export function scanPoints(scan: any): Points {
  const made: Points = { places: new Float32Array(scan.ranges.length * 3), count: 0 };
  for (let at = 0; at < scan.ranges.length; at++) {
    const range = scan.ranges[at];
    if (typeof range !== "number" || !(range >= scan.range_min && range <= scan.range_max)) continue;
    const angle = scan.angle_min + at * scan.angle_increment;
    made.places[made.count * 3] = range * Math.cos(angle);
    made.places[made.count * 3 + 1] = range * Math.sin(angle);
    made.count += 1;
  }
  return made;
}

const SCALE = new Float32Array(256 * 3); // from blue over green to red
for (let at = 0, colour = new Color(); at < 256; at++) colour.setHSL(0.68 * (1 - at / 255), 1, 0.52).toArray(SCALE, at * 3);
const LINEAR = Float32Array.from({ length: 256 }, (_, at) => new Color().setRGB(at / 255, 0, 0, "srgb").r);

/** Fill in the colour of each point; returns by what, `plain` where there is nothing to tell. */
export function colour(points: Points, wanted: Colouring, at: Matrix4, into: Float32Array): Colouring {
  const by = wanted === "auto" ? (points.rgb ? "rgb" : points.intensity ? "intensity" : "height") : wanted;
  if (by === "rgb" && points.rgb) {
    for (let i = 0; i < points.count * 3; i++) into[i] = LINEAR[points.rgb[i] as number] as number;
    return by;
  }
  const measured = by === "intensity" ? points.intensity : by === "height" ? heights(points, at) : undefined;
  if (!measured) return "plain";
  let [low, high] = [Infinity, -Infinity];
  for (let i = 0; i < points.count; i++) {
    const one = measured[i] as number;
    if (one < low) low = one;
    if (one > high) high = one;
  }
  const spread = high > low ? 255 / (high - low) : 0;
  for (let i = 0; i < points.count; i++) {
    const shade = Math.round(((measured[i] as number) - low) * spread) * 3;
    into[i * 3] = SCALE[shade] as number;
    into[i * 3 + 1] = SCALE[shade + 1] as number;
    into[i * 3 + 2] = SCALE[shade + 2] as number;
  }
  return by;
}

function heights({ places, count }: Points, { elements: m }: Matrix4): Float32Array {
  const made = new Float32Array(count);
  const [a, b, c] = [m[2] as number, m[6] as number, m[10] as number];
  for (let i = 0; i < count; i++) made[i] = a * (places[i * 3] as number) + b * (places[i * 3 + 1] as number) + c * (places[i * 3 + 2] as number);
  return made;
}
