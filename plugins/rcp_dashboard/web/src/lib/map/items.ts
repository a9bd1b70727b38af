/** Missions and fences as vehicles have them, and as people draw them. */
import { type Geo, toMetres } from "../geo.ts";

/** One item of a mission or fence, as `action/mission/upload` takes it. */
export interface Item {
  command: string;
  latitude: number;
  longitude: number;
  altitude: number;
  frame: string;
  params: (number | null)[];
}

/** One area of a fence: a polygon, or a circle about its one corner. */
export interface Area {
  inside: boolean;
  corners: Geo[];
  /** m, of a circle. */
  radius?: number;
}

export interface Fence {
  areas: Area[];
  /** What is no area, such as the point of return: kept as it is. */
  rest: Item[];
}

export const EMPTY: Fence = { areas: [], rest: [] };

const POLYGON = /^NAV_FENCE_POLYGON_VERTEX_(IN|EX)CLUSION$/;
const CIRCLE = /^NAV_FENCE_CIRCLE_(IN|EX)CLUSION$/;
/** Commands that are given without a place: the vehicle goes on from where it is. */
const PLACELESS = new Set(["NAV_TAKEOFF", "NAV_LAND", "NAV_VTOL_TAKEOFF", "NAV_VTOL_LAND"]);
const END = /^NAV_(RETURN_TO_LAUNCH|(VTOL_)?LAND)$/;
const WORDS: Record<string, string> = {
  NAV_WAYPOINT: "Waypoint",
  NAV_SPLINE_WAYPOINT: "Waypoint, curved",
  NAV_TAKEOFF: "Take off",
  NAV_LAND: "Land",
  NAV_RETURN_TO_LAUNCH: "Return home",
  NAV_LOITER_UNLIM: "Circle on",
  NAV_LOITER_TIME: "Stay a while",
  NAV_LOITER_TURNS: "Circle",
};

/** What an item does, in words. */
export function itemWord(item: Item): string {
  const known = WORDS[item.command];
  if (known) return known;
  const text = item.command.replace(/^(NAV|DO|CONDITION)_/, "").replaceAll("_", " ").toLowerCase();
  return text.charAt(0).toUpperCase() + text.slice(1);
}

/** Fill in what an item may lack. */
export function whole(given: Partial<Item> & { command: string }): Item {
  return { latitude: 0, longitude: 0, altitude: 0, frame: "relative", params: [], ...given };
}

/** Whether an item is at a place on the map. */
export function placed(item: Item): boolean {
  if (item.frame === "mission" || !item.command.startsWith("NAV_")) return false;
  return item.latitude !== 0 || item.longitude !== 0;
}

/** Whether an item has a height to fly at. */
export function high(item: Item): boolean {
  return placed(item) || PLACELESS.has(item.command);
}

export function waypoint(at: Geo, altitude: number): Item {
  return whole({ command: "NAV_WAYPOINT", ...at, altitude });
}

/** Where a new item belongs: a take-off first, an end last, any other after the one that is selected, or before the end. */
export function placeFor(items: Item[], item: Item, selected: number | undefined): number {
  if (/TAKEOFF$/.test(item.command)) return 0;
  if (END.test(item.command)) return items.length;
  if (selected !== undefined) return selected + 1;
  const last = items.findLastIndex((one) => !END.test(one.command));
  return last + 1;
}

/** The places that a mission leads to, home among them where an item is there. */
export function wayOf(items: Item[], home: Geo | undefined): Geo[] {
  const athome = (item: Item, place: number): boolean => item.command === "NAV_RETURN_TO_LAUNCH" || (place === 0 && /TAKEOFF$/.test(item.command));
  return items.flatMap((item, place) => (placed(item) ? [item] : home && athome(item, place) ? [home] : []));
}

/** The areas among the items of a fence. */
export function fenceOf(items: Item[]): Fence {
  const fence: Fence = { areas: [], rest: [] };
  let open: { area: Area; left: number; command: string } | undefined;
  for (const item of items) {
    const at = { latitude: item.latitude, longitude: item.longitude };
    if (POLYGON.test(item.command)) {
      if (!open || open.left === 0 || open.command !== item.command) {
        open = { area: { inside: item.command.endsWith("_INCLUSION"), corners: [] }, left: item.params[0] ?? 0, command: item.command };
        fence.areas.push(open.area);
      }
      open.area.corners.push(at);
      open.left -= 1;
      continue;
    }
    open = undefined;
    if (CIRCLE.test(item.command)) fence.areas.push({ inside: item.command.endsWith("_INCLUSION"), corners: [at], radius: item.params[0] ?? 0 });
    else fence.rest.push(item);
  }
  return fence;
}

/** The items of a fence, as vehicles take them. */
export function itemsOf({ areas, rest }: Fence): Item[] {
  const made = areas.flatMap(({ inside, corners, radius }) => {
    const word = inside ? "INCLUSION" : "EXCLUSION";
    const [command, first] = radius === undefined ? [`NAV_FENCE_POLYGON_VERTEX_${word}`, corners.length] : [`NAV_FENCE_CIRCLE_${word}`, radius];
    return corners.map((at) => whole({ command, ...at, params: [first] }));
  });
  return [...made, ...rest];
}

const FINE = { degrees: 1e-6, metres: 0.02 }; // as vehicles round

const nearby = (a: Geo, b: Geo): boolean => Math.abs(a.latitude - b.latitude) < FINE.degrees && Math.abs(a.longitude - b.longitude) < FINE.degrees;
const alike = (a: number, b: number): boolean => Math.abs(a - b) < FINE.metres;

/** Whether a vehicle has the items that were sent: it rounds, and keeps no parameters that it does not use. */
export function sameItems(sent: Item[], read: Item[]): boolean {
  return (
    sent.length === read.length &&
    sent.every((one, place) => {
      const other = read[place]!;
      if (one.command !== other.command) return false;
      if (placed(one) && !(placed(other) && nearby(one, other))) return false;
      return !high(one) || (one.frame === other.frame && alike(one.altitude, other.altitude));
    })
  );
}

/** Whether a vehicle has the fence that was sent. */
export function sameFence(sent: Fence, read: Fence): boolean {
  return (
    sent.areas.length === read.areas.length &&
    sent.areas.every((one, place) => {
      const other = read.areas[place]!;
      if (one.inside !== other.inside || one.corners.length !== other.corners.length) return false;
      if ((one.radius === undefined) !== (other.radius === undefined) || !alike(one.radius ?? 0, other.radius ?? 0)) return false;
      return one.corners.every((at, corner) => nearby(at, other.corners[corner]!));
    }) &&
    sameItems(sent.rest, read.rest)
  );
}

/** The list with one item at another place. */
export function moved<T>(list: readonly T[], from: number, to: number): T[] {
  const made = [...list];
  const [one] = made.splice(from, 1);
  if (one !== undefined && to >= 0 && to <= made.length) made.splice(to, 0, one);
  return one !== undefined && (to < 0 || to > list.length - 1) ? [...list] : made;
}

/** Where a new corner belongs: into the side that it is nearest to. */
export function sideFor(corners: Geo[], at: Geo): number {
  if (corners.length < 3) return corners.length;
  const spots = corners.map((one) => toMetres(one, at));
  const far = spots.map((a, place) => {
    const b = spots[(place + 1) % spots.length]!;
    const [dx, dy] = [b.x - a.x, b.y - a.y];
    const along = Math.min(1, Math.max(0, -(a.x * dx + a.y * dy) / (dx * dx + dy * dy || 1)));
    return Math.hypot(a.x + along * dx, a.y + along * dy);
  });
  return far.indexOf(Math.min(...far)) + 1;
}
