/** What the kind of a vehicle means for its plan, as `sensor/vehicle` tells it; undefined while it is not known. */

const GROUND = new Set(["rover", "boat"]);
const BELOW = "sub";

/** Whether it is known to heed no heights. What a role may see of a vehicle tells nothing of that. */
export function drives(kind: string | undefined): boolean {
  return kind !== undefined && GROUND.has(kind);
}

/** Whether it may fly, as far as is known. */
export function mayFly(kind: string | undefined): boolean {
  return !drives(kind) && kind !== BELOW;
}

/** The height of a new item in m: NaN where none was given, which is not uploaded. */
export function heightFor(kind: string | undefined, given: number | null): number {
  return drives(kind) ? 0 : (given ?? NaN);
}
