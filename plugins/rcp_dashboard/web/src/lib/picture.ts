/** Pictures of robots as something that a canvas draws; no address is made for them. */
import { bytesOf, viewOf } from "./bytes.ts";

const CHANNELS: Record<string, [number, number, number, number]> = {
  rgb8: [3, 0, 1, 2],
  bgr8: [3, 2, 1, 0],
  rgba8: [4, 0, 1, 2],
  bgra8: [4, 2, 1, 0],
  mono8: [1, 0, 0, 0],
  "8UC1": [1, 0, 0, 0],
  "8UC3": [3, 2, 1, 0],
  "8UC4": [4, 2, 1, 0],
};

/** Pictures of measures: bytes of one, how it is read, and in which part of a metre where that is known. */
const MEASURES: Record<string, [number, (view: DataView, at: number, little: boolean) => number, number | undefined]> = {
  "16UC1": [2, (view, at, little) => view.getUint16(at, little), 0.001],
  mono16: [2, (view, at, little) => view.getUint16(at, little), undefined],
  "32FC1": [4, (view, at, little) => view.getFloat32(at, little), 1],
};

export interface Picture {
  image: ImageBitmap;
  /** What black and white stand for in a picture of measures, in metres. */
  range?: [number, number];
}

/** Decode a compressed picture, or raw rows as ROS 2 has them: depths are greys, the near ones bright. */
export async function picture(value: any): Promise<Picture> {
  const data = bytesOf(value.data);
  const { width, height, encoding } = value;
  if (encoding === undefined) return { image: await createImageBitmap(new Blob([data])) };
  const pixels = new ImageData(width, height);
  const colours = CHANNELS[encoding];
  const measure = MEASURES[encoding];
  if (!colours && !measure) throw new Error(`unsupported encoding ${encoding}`);
  const step = value.step || width * (colours?.[0] ?? measure![0]);
  if (data.length < step * height) throw new Error("the image data is incomplete");
  if (colours) {
    copy(pixels, data, step, colours);
    return { image: await createImageBitmap(pixels) };
  }
  const [size, read, scale] = measure!;
  const range = greys(pixels, viewOf(data), step, size, (view, at) => read(view, at, !value.is_bigendian), scale !== undefined);
  return { image: await createImageBitmap(pixels), ...(scale && range && { range: [range[0] * scale, range[1] * scale] }) };
}

function copy({ data: to, width, height }: ImageData, data: Uint8Array, step: number, [size, r, g, b]: [number, number, number, number]): void {
  for (let y = 0, at = 0; y < height; y++)
    for (let x = 0, from = y * step; x < width; x++, from += size) {
      to[at++] = data[from + r] as number;
      to[at++] = data[from + g] as number;
      to[at++] = data[from + b] as number;
      to[at++] = 255;
    }
}

/** Spread what was measured over all greys; what was not (0, NaN, infinity) stays black. */
function greys(
  { data: to, width, height }: ImageData, view: DataView, step: number, size: number, read: (view: DataView, at: number) => number, near: boolean,
): [number, number] | undefined {
  let [low, high] = [Infinity, -Infinity];
  const found = new Float32Array(width * height);
  for (let y = 0, at = 0; y < height; y++)
    for (let x = 0; x < width; x++, at++) {
      const one = (found[at] = read(view, y * step + x * size));
      if (!Number.isFinite(one) || (near && one <= 0)) found[at] = NaN;
      else {
        if (one < low) low = one;
        if (one > high) high = one;
      }
    }
  const spread = high > low ? 215 / (high - low) : 0;
  for (let at = 0; at < found.length; at++) {
    const one = found[at] as number;
    to.fill(Number.isNaN(one) ? 0 : near ? 255 - (one - low) * spread : 40 + (one - low) * spread, at * 4, at * 4 + 3);
    to[at * 4 + 3] = 255;
  }
  return low <= high ? [low, high] : undefined;
}
