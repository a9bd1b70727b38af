import { DataTexture, Matrix4, Mesh, NearestFilter, PlaneGeometry, RedFormat, ShaderMaterial, UnsignedByteType } from "three";

import { bytesOf } from "../bytes.ts";
import { matrixOf } from "./frames.ts";

// The cells are drawn as they came: 0 free … 100 occupied, all above is unknown. Where several fall on
// one pixel the fullest is shown, so that a thin wall does not vanish in the distance.
const VERTEX = `
varying vec2 at;
void main() {
  at = uv;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;
const FRAGMENT = `
uniform sampler2D cells;
uniform float free;
uniform float full;
uniform float opacity;
uniform bool costs;
varying vec2 at;
float cell(vec2 place) {
  float found = texture2D(cells, place).r * 255.0;
  return found > 100.5 ? -1.0 : found;
}
void main() {
  vec2 dx = dFdx(at) * 0.25;
  vec2 dy = dFdy(at) * 0.25;
  float found = max(max(cell(at + dx + dy), cell(at - dx - dy)), max(cell(at + dx - dy), cell(at - dx + dy)));
  if (found < 0.0 || (costs && found < 0.5)) discard;
  if (!costs) gl_FragColor = vec4(vec3(mix(free, full, found / 100.0)), found < 0.5 ? 0.8 : 1.0);
  else if (found > 99.5) gl_FragColor = vec4(0.78, 0.1, 0.72, opacity);
  else if (found > 98.5) gl_FragColor = vec4(0.1, 0.75, 0.8, opacity);
  else gl_FragColor = vec4(mix(vec3(0.15, 0.3, 0.95), vec3(0.95, 0.2, 0.1), found / 98.0), opacity);
}`;

const WIDEST = 8192; // cells of a side that any graphics card takes as a picture

/**
 * A map in cells, as a picture on the floor: free is light, occupied dark, unknown not there.
 *
 * What driving there costs has colours: from blue to red, then where the robot would touch something (99), then obstacles (100); what costs nothing is not there.
 */
export class Grid {
  readonly object: Mesh<PlaneGeometry, ShaderMaterial>;
  readonly #size: string;
  #inner: Matrix4;

  constructor(grid: any, dark: boolean, costs = false) {
    const { resolution, width, height } = grid.info ?? grid;
    if (!(resolution > 0 && Number.isFinite(resolution))) throw new Error("its resolution is not above zero");
    this.#size = sizeOf(grid);
    const texture = new DataTexture(cellsOf(grid), width, height, RedFormat, UnsignedByteType);
    texture.magFilter = texture.minFilter = NearestFilter;
    const material = new ShaderMaterial({
      uniforms: { cells: { value: texture }, free: { value: 0 }, full: { value: 0 }, opacity: { value: 1 }, costs: { value: costs } },
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      transparent: true,
      depthWrite: false, // grids lie upon each other, in the order in which they are drawn
    });
    this.object = new Mesh(new PlaneGeometry(width * resolution, height * resolution), material);
    this.object.geometry.translate((width * resolution) / 2, (height * resolution) / 2, -0.01);
    this.object.matrixAutoUpdate = false;
    this.#inner = originOf(grid);
    this.theme(dark);
    this.#texture.needsUpdate = true;
  }

  get #texture(): DataTexture {
    return this.object.material.uniforms["cells"]!.value;
  }

  /** Take another map of the same size; false if it is of another one. */
  take(grid: any): boolean {
    if (sizeOf(grid) !== this.#size) return false;
    this.#texture.image.data = cellsOf(grid);
    this.#texture.needsUpdate = true;
    this.#inner = originOf(grid);
    return true;
  }

  /** Take a part of it that has changed. */
  patch(update: any): void {
    const { x, y, width, height } = update;
    const { image } = this.#texture;
    const cells = cellsOf(update);
    if (![x, y].every(Number.isInteger) || x < 0 || y < 0 || x + width > image.width || y + height > image.height) throw new Error("an update lies outside of it");
    for (let row = 0; row < height; row++) (image.data as Uint8Array).set(cells.subarray(row * width, (row + 1) * width), (y + row) * image.width + x);
    this.#texture.needsUpdate = true;
  }

  fade(opacity: number): void {
    this.object.material.uniforms["opacity"]!.value = opacity;
  }

  /** Square metres. */
  get area(): number {
    const { width, height } = this.object.geometry.parameters;
    return width * height;
  }

  theme(dark: boolean): void {
    const { free, full } = this.object.material.uniforms as Record<string, { value: number }>;
    [free!.value, full!.value] = dark ? [0.18, 0.8] : [1, 0.16];
  }

  /** Where its corner is in its frame. */
  get inner(): Matrix4 {
    return this.#inner;
  }
}

function sizeOf(grid: any): string {
  const { resolution, width, height } = grid.info ?? grid;
  return `${width} ${height} ${resolution}`;
}

function originOf(grid: any): Matrix4 {
  const { origin } = grid.info ?? grid;
  return matrixOf(origin?.position, origin?.orientation);
}

function cellsOf(grid: any): Uint8Array<ArrayBuffer> {
  const { width, height } = grid.info ?? grid;
  if (![width, height].every((side) => Number.isInteger(side) && side > 0)) throw new Error(`its size is ${width} x ${height}`);
  if (Math.max(width, height) > WIDEST) throw new Error(`it is ${width} x ${height} cells large: ${WIDEST} a side is the most`);
  const cells = Array.isArray(grid.data) ? Uint8Array.from(grid.data) : bytesOf(grid.data).slice(); // -1 becomes 255
  if (cells.length !== width * height) throw new Error(`it has ${cells.length} cells, not ${width} x ${height}`);
  return cells;
}
