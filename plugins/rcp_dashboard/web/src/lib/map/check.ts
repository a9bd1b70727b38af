/** What is wrong with a mission or a fence, before a vehicle is asked. */
import { type Geo, toMetres } from "../geo.ts";
import { height, measured } from "../units.svelte.ts";
import { type Area, EMPTY, type Fence, high, type Item, itemWord, placed } from "./items.ts";
import { mayFly } from "./kinds.ts";

export interface Finding {
  /** Whether it must not be uploaded so. */
  wrong: boolean;
  text: string;
}

interface Spot {
  x: number;
  y: number;
}

const FAR = 20_000; // m between two items: probably a slip of the mouse, or of a number
const HIGH = 120; // m, above which most places ask for permission

const wrong = (text: string): Finding => ({ wrong: true, text });
const odd = (text: string): Finding => ({ wrong: false, text });

export function distance(a: Geo, b: Geo): number {
  const { x, y } = toMetres(b, a);
  return Math.hypot(x, y);
}

function turn(a: Spot, b: Spot, c: Spot): number {
  return Math.sign((b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x));
}

function cross(a: Spot, b: Spot, c: Spot, d: Spot): boolean {
  return turn(a, b, c) !== turn(a, b, d) && turn(c, d, a) !== turn(c, d, b);
}

/** Whether a place is within a polygon or circle. */
export function within(area: Area, at: Geo): boolean {
  if (area.radius !== undefined) return distance(area.corners[0]!, at) <= area.radius;
  const spots = area.corners.map((one) => toMetres(one, at));
  let inside = false;
  spots.forEach((a, place) => {
    const b = spots[(place + 1) % spots.length]!;
    if (a.y > 0 !== b.y > 0 && (b.x - a.x) * (a.y / (a.y - b.y)) + a.x > 0) inside = !inside;
  });
  return inside;
}

/** Whether the sides of a polygon cross each other. */
export function crossed({ corners }: Area): boolean {
  const [origin] = corners;
  if (!origin || corners.length < 4) return false;
  const spots = corners.map((one) => toMetres(one, origin));
  const count = spots.length;
  return spots.some((a, i) =>
    spots.some((c, j) => {
      const apart = j > i + 1 && !(i === 0 && j === count - 1);
      return apart && cross(a, spots[(i + 1) % count]!, c, spots[(j + 1) % count]!);
    }),
  );
}

/** Whether the way between two places meets the edge of an area. */
function meets(area: Area, from: Geo, to: Geo): boolean {
  const [a, b] = [toMetres(from, from), toMetres(to, from)];
  if (area.radius !== undefined) {
    const middle = toMetres(area.corners[0]!, from);
    const along = Math.min(1, Math.max(0, (middle.x * b.x + middle.y * b.y) / (b.x * b.x + b.y * b.y || 1)));
    const near = Math.hypot(middle.x - along * b.x, middle.y - along * b.y) <= area.radius;
    return near && !(within(area, from) && within(area, to)); // a circle bends outwards: between two places in it all is in it
  }
  const spots = area.corners.map((one) => toMetres(one, from));
  return spots.some((c, place) => cross(a, b, c, spots[(place + 1) % spots.length]!));
}

/** Why a place is not within a fence; undefined where it is. */
export function outside(fence: Fence, at: Geo): string | undefined {
  if (fence.areas.some((area) => area.inside && !within(area, at))) return "outside the fence";
  return fence.areas.some((area) => !area.inside && within(area, at)) ? "in an area that the fence keeps out" : undefined;
}

/** What is wrong with a fence; `vehicles` are places that have to be within it. */
export function checkFence(fence: Fence, vehicles: { name: string; at: Geo }[] = []): Finding[] {
  if (fence.areas.length + fence.rest.length === 0) return [odd("The fence is empty: the vehicle will have none.")];
  const found: Finding[] = [];
  fence.areas.forEach((area, place) => {
    const name = `Area ${place + 1}`;
    if (area.corners.some(({ latitude, longitude }) => Math.abs(latitude) > 90 || Math.abs(longitude) > 180)) return void found.push(wrong(`${name} is at no place on Earth.`));
    if (area.radius !== undefined) {
      if (!(area.radius > 0)) found.push(wrong(`${name}: the circle has no radius.`));
    } else if (area.corners.length < 3) found.push(wrong(`${name}: a polygon needs three corners.`));
    else if (crossed(area)) found.push(wrong(`${name}: its sides cross each other.`));
  });
  if (found.length === 0)
    for (const { name, at } of vehicles) {
      const why = outside(fence, at);
      if (why) found.push(odd(`${name} is ${why}.`));
    }
  return found;
}

/** What is wrong with a mission of a vehicle of a kind within its fence; either is undefined where it is not known. */
export function checkMission(items: Item[], known: Fence | undefined, kind: string | undefined): Finding[] {
  if (items.length === 0) return [odd("The mission is empty: the vehicle will have none.")];
  const found: Finding[] = [];
  const fence = known ?? EMPTY;
  const usable = checkFence(fence).every((one) => !one.wrong);
  if (!known) found.push(odd("The vehicle's fence is not known: nothing was checked against it."));
  let last: { at: Item; name: string } | undefined;
  items.forEach((item, place) => {
    const name = `${place + 1} (${itemWord(item)})`;
    if (![item.latitude, item.longitude, item.altitude].every(Number.isFinite)) return void found.push(wrong(`${name} needs a place and a height.`));
    if (Math.abs(item.latitude) > 90 || Math.abs(item.longitude) > 180) return void found.push(wrong(`${name} is at no place on Earth.`));
    if (mayFly(kind) && high(item) && item.frame === "relative" && !/LAND$/.test(item.command)) {
      if (item.altitude <= 0) found.push(odd(`${name} is at ${height(item.altitude)}: on the ground of home, or below it.`));
      else if (item.altitude > HIGH) found.push(odd(`${name} is ${height(item.altitude)} above home.`));
    }
    if (kind === "sub" && high(item) && item.frame === "relative" && item.altitude > 0) found.push(odd(`${name} is ${height(item.altitude)} above home: out of the water.`));
    if (!placed(item)) return;
    const why = usable ? outside(fence, item) : undefined;
    if (why) found.push(odd(`${name} is ${why}.`)); // whether the fence is enabled, the vehicle knows
    if (last) {
      const far = distance(last.at, item);
      if (far > FAR) found.push(odd(`${name} is ${measured(far / 1000, "km", 0)} from ${last.name}.`));
      const out = usable && !why && !outside(fence, last.at) && fence.areas.some((area) => meets(area, last!.at, item));
      if (out) found.push(odd(`The way from ${last.name} to ${name} leaves the fence.`));
    }
    last = { at: item, name };
  });
  if (mayFly(kind) && !/TAKEOFF$/.test(items[0]!.command)) found.push(odd("It does not begin with a take-off: the vehicle has to be in the air."));
  return found;
}

/** How long the way is, in m. */
export function lengthOf(items: Item[]): number {
  const places = items.filter(placed);
  return places.slice(1).reduce((sum, at, place) => sum + distance(places[place]!, at), 0);
}
