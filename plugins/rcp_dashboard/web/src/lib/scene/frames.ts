import { Matrix4, Quaternion, Vector3 } from "three";

export const FARTHEST = 1e9; // m: what is farther away is no place, and leaves the picture without numbers

/** Whether these are numbers that can be drawn. */
export const drawable = (...values: unknown[]): boolean => values.every((one) => Number.isFinite(one) && Math.abs(one as number) <= FARTHEST);

/** A pose or transform of the wire as a matrix; four zeros are what a message begins with: they are taken for no rotation. */
export function matrixOf(position: any, orientation: any): Matrix4 {
  const { x = 0, y = 0, z = 0 } = position ?? {};
  const { x: qx = 0, y: qy = 0, z: qz = 0, w = 1 } = orientation ?? {};
  if (!drawable(x, y, z, qx, qy, qz, w)) throw new Error("its pose has something that is not a number, or is too far away");
  return new Matrix4().compose(new Vector3(x, y, z), new Quaternion(qx, qy, qz, w).normalize(), new Vector3(1, 1, 1));
}

const bare = (name: unknown): string => String(name).replace(/^\//, "");
const DEEP = 256; // frames in one chain; more is a ring

/** The tree of frames, as far as transforms of it have come. */
export class Frames {
  #above = new Map<string, { parent: string; matrix: Matrix4; source: string }>();
  #names: string[] = [];

  /** All that are known, whether they hang from another one or others hang from them. */
  get names(): readonly string[] {
    return this.#names;
  }

  /** Take one transform, or a list of them, that a source tells; raises for those that are wrong when the others are taken. */
  take(value: any, source: string): void {
    let wrong = "";
    for (const one of value.transforms ?? (Array.isArray(value) ? value : [value])) {
      if (typeof one !== "object" || one === null) continue;
      const transform = one.transform ?? one;
      const parent = bare(one.header?.frame_id ?? one.frame_id ?? one.parent ?? "");
      const child = bare(one.child_frame_id ?? one.child ?? "");
      if (!parent || !child || parent === child) continue;
      const known = this.#above.get(child);
      let matrix: Matrix4;
      try {
        matrix = matrixOf(transform.translation, transform.rotation);
      } catch (error) {
        wrong ||= `${child}: ${(error as Error).message}`;
        continue; // it stays where it was
      }
      if (this.#above.get(parent)?.parent === child) this.#above.delete(parent); // it was told the other way round
      this.#above.set(child, { parent, matrix, source });
      if (known?.parent !== parent) this.#named();
    }
    if (wrong) throw new Error(wrong);
  }

  /** Leave out what a source has told. */
  forget(source: string): void {
    for (const [child, above] of this.#above) if (above.source === source) this.#above.delete(child);
    this.#named();
  }

  #named(): void {
    this.#names = [...new Set([...this.#above].flatMap(([name, above]) => [name, above.parent]))].sort();
  }

  /** The name by which a frame is known here: its own, or the only one that ends with it. */
  find(name: string): string | undefined {
    const wanted = bare(name);
    if (this.#names.includes(wanted)) return wanted;
    const prefixed = this.#names.filter((one) => one.endsWith(`/${wanted}`));
    return prefixed.length === 1 ? prefixed[0] : undefined;
  }

  /** The frame that all above this one hangs from. */
  root(name: string): string {
    return this.#up(name).at(-1)?.[0] ?? name;
  }

  /** The frames from one up to its root, each with what takes the points of the first into it. */
  #up(name: string): [string, Matrix4][] {
    const chain: [string, Matrix4][] = [[name, new Matrix4()]];
    let at = this.#above.get(name);
    while (at && chain.length < DEEP) {
      const below = chain.at(-1)![1];
      chain.push([at.parent, new Matrix4().multiplyMatrices(at.matrix, below)]);
      at = this.#above.get(at.parent);
    }
    return chain;
  }

  /** What takes points of a frame into another one; undefined where nothing joins them. */
  between(source: string, target: string): Matrix4 | undefined {
    const [from, to] = [this.find(source), this.find(target)];
    if (from === undefined || to === undefined) return undefined;
    if (from === to) return new Matrix4();
    const down = new Map(this.#up(to));
    for (const [name, matrix] of this.#up(from)) {
      const back = down.get(name);
      if (back) return new Matrix4().copy(back).invert().multiply(matrix);
    }
    return undefined;
  }
}
