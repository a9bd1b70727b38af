/** Where labels are written so that none covers another. */

/** A part of the picture, in whatever unit its sides are told. */
export interface Area {
  left: number;
  right: number;
  low: number;
  high: number;
}

/** A label that wants room beside its place; the most important ones come first. */
export interface Wish {
  key: string;
  x: number;
  y: number;
  width: number;
  height: number;
}

/** Where the place is within the label, in parts of its size: the label is beside it, then on the other sides. */
export type Anchor = readonly [x: number, y: number];

/** The area of a label with one of its anchors at its place. */
function areaOf({ x, y, width, height }: Wish, [ax, ay]: Anchor): Area {
  const [left, low] = [x - ax * width, y - ay * height];
  return { left, right: left + width, low, high: low + height };
}

const meet = (a: Area, b: Area): boolean => a.left < b.right && b.left < a.right && a.low < b.high && b.low < a.high;

/**
 * Choose an anchor for each label that has room, and none for the others.
 *
 * A label stays where it was `before` as long as it can, so that nothing jumps. What is `taken` is kept free.
 */
export function declutter(wishes: Iterable<Wish>, anchors: (wish: Wish) => readonly Anchor[], taken: readonly Area[], before: ReadonlyMap<string, number>): Map<string, number> {
  const used = [...taken];
  const made = new Map<string, number>();
  for (const wish of wishes) {
    const sides = anchors(wish);
    const first = before.get(wish.key);
    const order = [...sides.keys()].sort((a, b) => Number(b === first) - Number(a === first));
    for (const side of order) {
      const area = areaOf(wish, sides[side]!);
      if (used.some((one) => meet(one, area))) continue;
      used.push(area);
      made.set(wish.key, side);
      break;
    }
  }
  return made;
}
