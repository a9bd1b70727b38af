import { Matrix4, Quaternion, Vector3 } from "three";

/** A pose or transform of the wire as a matrix. */
export function matrixOf(position: any, orientation: any): Matrix4 {
  const { x = 0, y = 0, z = 0 } = position ?? {};
  const { x: qx = 0, y: qy = 0, z: qz = 0, w = 1 } = orientation ?? {};
  return new Matrix4().compose(new Vector3(x, y, z), new Quaternion(qx, qy, qz, w), new Vector3(1, 1, 1));
}

/** The tree of frames, as far as transforms of it have come. */
export class Frames {
  #known = new Map<string, { parent: string; matrix: Matrix4 }>();

  get names(): string[] {
    return [...this.#known.keys()];
  }

  /** Take one transform, or a list of them. */
  take(value: any): void {
    for (const one of value.transforms ?? (Array.isArray(value) ? value : [value])) {
      const transform = one.transform ?? one;
      const parent = one.header?.frame_id ?? one.frame_id ?? one.parent;
      const child = one.child_frame_id ?? one.child;
      if (!parent || !child) continue;
      this.#known.set(child, { parent, matrix: matrixOf(transform.translation, transform.rotation) });
    }
  }

  /** What takes points of a frame into another one; undefined where nothing joins them. */
  between(frame: string, fixed: string): Matrix4 | undefined {
    const matrix = new Matrix4();
    let at = frame;
    for (let depth = 0; at !== fixed; depth++) {
      const step = this.#known.get(at);
      if (!step || depth > 64) return undefined;
      matrix.premultiply(step.matrix);
      at = step.parent;
    }
    return matrix;
  }
}
