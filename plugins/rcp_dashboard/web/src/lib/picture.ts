/** Pictures of robots as something that a canvas draws; no address is made for them. */

function bytesOf(text: string): Uint8Array<ArrayBuffer> {
  const binary = atob(text);
  const made = new Uint8Array(binary.length);
  for (let at = 0; at < binary.length; at++) made[at] = binary.charCodeAt(at);
  return made;
}

export { bytesOf };

const CHANNELS: Record<string, [number, number, number, number]> = {
  rgb8: [3, 0, 1, 2],
  bgr8: [3, 2, 1, 0],
  rgba8: [4, 0, 1, 2],
  bgra8: [4, 2, 1, 0],
  mono8: [1, 0, 0, 0],
  "8UC1": [1, 0, 0, 0],
  "8UC3": [3, 2, 1, 0],
};

/** Decode a compressed picture, or raw rows as ROS 2 has them. */
export async function picture(value: any): Promise<ImageBitmap> {
  const data = bytesOf(value.data);
  const kind = CHANNELS[value.encoding];
  if (!kind || !value.step) return createImageBitmap(new Blob([data]));
  const [size, r, g, b] = kind;
  const { width, height, step } = value;
  const pixels = new ImageData(width, height);
  for (let y = 0, to = 0; y < height; y++)
    for (let x = 0, from = y * step; x < width; x++, from += size) {
      pixels.data[to++] = data[from + r] as number;
      pixels.data[to++] = data[from + g] as number;
      pixels.data[to++] = data[from + b] as number;
      pixels.data[to++] = 255;
    }
  return createImageBitmap(pixels);
}
