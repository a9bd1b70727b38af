import { describe, expect, it } from "vitest";

import { type Geo, toGeo } from "../src/lib/geo.ts";
import { checkFence, checkMission, crossed, lengthOf, outside, within } from "../src/lib/map/check.ts";
import { drives, heightFor } from "../src/lib/map/kinds.ts";
import { type Area, EMPTY, type Fence, fenceOf, type Item, itemsOf, moved, placeFor, sideFor, waypoint, wayOf, whole } from "../src/lib/map/items.ts";
import { Plane } from "../src/lib/map/plane.ts";
import { styleOf, wordsOf } from "../src/lib/map/style.ts";

const HOME = { latitude: -35.3632621, longitude: 149.1652374 };
const at = (x: number, y: number): Geo => toGeo(x, y, HOME);
const flight = (...spots: [number, number][]): Item[] => [{ ...whole({ command: "NAV_TAKEOFF" }), altitude: 20 }, ...spots.map(([x, y]) => waypoint(at(x, y), 20))];
const square = (half: number, inside = true, x = 0, y = 0): Area => ({ inside, corners: [at(x - half, y - half), at(x + half, y - half), at(x + half, y + half), at(x - half, y + half)] });
const fence = (...areas: Area[]): Fence => ({ areas, rest: [] });
const told = (items: Item[], of: Fence | undefined = EMPTY, kind: string | undefined = "copter"): string[] => checkMission(items, of, kind).map((one) => `${one.wrong ? "✕" : "▲"} ${one.text}`);

function plane(): Plane {
  const made = new Plane();
  made.size = { width: 800, height: 600 };
  made.begin(HOME);
  return made;
}

describe("the plane", () => {
  it("begins at four pixels in a metre, and leads back from the screen to the place", () => {
    const made = plane();
    expect(made.scale).toBeCloseTo(4, 6);
    const [x, y] = made.toScreen(at(50, 25));
    expect([x, y]).toEqual([expect.closeTo(600, 1), expect.closeTo(200, 1)]);
    const back = made.at(x, y);
    expect(back.latitude).toBeCloseTo(at(50, 25).latitude, 9);
    expect(back.longitude).toBeCloseTo(at(50, 25).longitude, 9);
  });

  it("keeps what is at a pixel there when it zooms", () => {
    const made = plane();
    const before = made.at(100, 500);
    made.zoom(3, 100, 500);
    expect(made.at(100, 500).latitude).toBeCloseTo(before.latitude, 9);
    expect(made.at(100, 500).longitude).toBeCloseTo(before.longitude, 9);
  });

  it("shows all places, also across the date line, and never what lies beyond a pole", () => {
    const made = plane();
    const places = [{ latitude: -17, longitude: 179.9 }, { latitude: -17.1, longitude: -179.9 }];
    made.fit(places);
    for (const [x, y] of places.map((one) => made.toScreen(one))) {
      expect(x).toBeGreaterThan(0);
      expect(x).toBeLessThan(800);
      expect(y).toBeGreaterThan(0);
      expect(y).toBeLessThan(600);
    }
    for (let step = 0; step < 60; step++) made.zoom(0.5);
    for (let step = 0; step < 60; step++) made.move(0, 5000);
    expect(made.at(0, 0).latitude).toBeLessThanOrEqual(85.06);
    expect(Number.isFinite(made.zoomed)).toBe(true);
  });

  it("takes odd places without losing its own", () => {
    const made = plane();
    made.fit([{ latitude: 1e300, longitude: -4e5 }]);
    expect(made.toScreen(HOME).every(Number.isFinite)).toBe(true);
  });
});

describe("items", () => {
  it("makes areas of the items of a fence, and the same items of them", () => {
    const items = [
      ...square(100).corners.map((one) => whole({ command: "NAV_FENCE_POLYGON_VERTEX_INCLUSION", ...one, params: [4] })),
      ...square(10).corners.slice(1).map((one) => whole({ command: "NAV_FENCE_POLYGON_VERTEX_EXCLUSION", ...one, params: [3] })),
      ...square(20).corners.slice(1).map((one) => whole({ command: "NAV_FENCE_POLYGON_VERTEX_EXCLUSION", ...one, params: [3] })),
      whole({ command: "NAV_FENCE_CIRCLE_INCLUSION", ...HOME, params: [80] }),
      whole({ command: "NAV_FENCE_RETURN_POINT", ...HOME, altitude: 30 }),
    ];
    const found = fenceOf(items);
    expect(found.areas.map((one) => [one.inside, one.corners.length, one.radius])).toEqual([[true, 4, undefined], [false, 3, undefined], [false, 3, undefined], [true, 1, 80]]);
    expect(itemsOf(found)).toEqual(items);
  });

  it("moves an item, and leaves the list as it is where it cannot go", () => {
    expect(moved(["a", "b", "c"], 0, 2)).toEqual(["b", "c", "a"]);
    expect(moved(["a", "b"], 0, -1)).toEqual(["a", "b"]);
    expect(moved(["a", "b"], 1, 2)).toEqual(["a", "b"]);
  });

  it("puts a new item where it belongs", () => {
    const home = whole({ command: "NAV_RETURN_TO_LAUNCH", frame: "mission" });
    const items = [...flight([10, 0], [20, 0]), home];
    expect(placeFor(items, waypoint(HOME, 5), undefined)).toBe(3);
    expect(placeFor(items, waypoint(HOME, 5), 1)).toBe(2);
    expect(placeFor(items, whole({ command: "NAV_TAKEOFF" }), 2)).toBe(0);
    expect(placeFor(items.slice(0, 3), home, 1)).toBe(3);
    expect(placeFor([], waypoint(HOME, 5), undefined)).toBe(0);
  });

  it("puts a new corner into the side that it is nearest to", () => {
    expect(sideFor(square(100).corners, at(0, 130))).toBe(3);
    expect(sideFor(square(100).corners, at(-120, 5))).toBe(4);
    expect(sideFor(square(100).corners.slice(2), at(0, 0))).toBe(2);
  });

  it("leads from home and back to it", () => {
    const items = [...flight([10, 0]), whole({ command: "NAV_RETURN_TO_LAUNCH", frame: "mission" })];
    expect(wayOf(items, HOME)).toEqual([HOME, items[1], HOME]);
    expect(wayOf(items, undefined)).toEqual([items[1]]);
  });
});

describe("checks", () => {
  it("find nothing wrong with a flight within its fence", () => {
    expect(told(flight([50, 0], [50, 50]), fence(square(100)))).toEqual([]);
    expect(lengthOf(flight([0, 0], [30, 40], [30, 50]))).toBeCloseTo(60, 1);
  });

  it("find what is outside, in a kept-out area, or on a way through one", () => {
    expect(told(flight([150, 0]), fence(square(100)))).toEqual(["▲ 2 (Waypoint) is outside the fence."]);
    expect(told(flight([0, 0]), fence(square(10, false)))).toEqual(["▲ 2 (Waypoint) is in an area that the fence keeps out."]);
    expect(told(flight([-50, 0], [50, 0]), fence(square(10, false)))).toEqual(["▲ The way from 2 (Waypoint) to 3 (Waypoint) leaves the fence."]);
    const round: Area = { inside: false, corners: [at(0, 0)], radius: 10 };
    expect(told(flight([-50, 5], [50, 5]), fence(round))).toHaveLength(1);
    expect(told(flight([-50, 15], [50, 15]), fence(round))).toEqual([]);
    expect(told(flight([-50, 15], [50, 15]), fence({ ...round, inside: true, radius: 60 }))).toEqual([]);
  });

  it("find heights, slips and what has no place", () => {
    expect(told([])).toEqual(["▲ The mission is empty: the vehicle will have none."]);
    expect(told([waypoint(HOME, 20)])[0]).toContain("does not begin with a take-off");
    expect(told([...flight(), waypoint(HOME, 0)])[0]).toContain("on the ground of home");
    expect(told([...flight(), waypoint(HOME, 500)])[0]).toContain("500 m above home");
    expect(told([...flight(), waypoint({ ...HOME, latitude: NaN }, 5)])[0]).toBe("✕ 2 (Waypoint) needs a place and a height.");
    expect(told(flight([0, 0], [0, 90_000]))[0]).toContain("90 km from");
    expect(told([waypoint(HOME, 0)], EMPTY, "rover")).toEqual([]);
  });

  it("heed heights unless a vehicle is known to heed none", () => {
    expect(checkMission([...flight(), waypoint(HOME, 0)], EMPTY, undefined)[0]!.text).toContain("on the ground of home");
    expect(told([waypoint(HOME, -5), waypoint(HOME, 20)], EMPTY, "sub")).toEqual(["▲ 2 (Waypoint) is 20 m above home: out of the water."]);
    expect(told([waypoint(HOME, heightFor("copter", null))])[0]).toBe("✕ 1 (Waypoint) needs a place and a height.");
    expect([heightFor(undefined, 7), heightFor("boat", 7), heightFor("boat", null), heightFor("sub", -3)]).toEqual([7, 0, 0, -3]);
    expect(["rover", "boat", "sub", "copter", undefined].map(drives)).toEqual([true, true, false, false, false]);
  });

  it("tell of a fence that is empty or not known", () => {
    expect(checkFence(EMPTY)).toEqual([{ wrong: false, text: "The fence is empty: the vehicle will have none." }]);
    expect(checkMission(flight([50, 0]), undefined, "copter")).toEqual([{ wrong: false, text: "The vehicle's fence is not known: nothing was checked against it." }]);
  });

  it("find fences that are none", () => {
    const [a, b, c, d] = square(50).corners as [Geo, Geo, Geo, Geo];
    expect(crossed({ inside: true, corners: [a, c, b, d] })).toBe(true);
    expect(crossed(square(50))).toBe(false);
    expect(checkFence(fence({ inside: true, corners: [a, b] }))[0]!.text).toContain("needs three corners");
    expect(checkFence(fence({ inside: true, corners: [a], radius: 0 }))[0]!.text).toContain("no radius");
    expect(checkFence(fence({ inside: true, corners: [a, b, { ...c, latitude: 4737 }] }))[0]).toEqual({ wrong: true, text: "Area 1 is at no place on Earth." });
    expect(checkFence(fence(square(50, true, 200, 0)), [{ name: "Home", at: HOME }])).toEqual([{ wrong: false, text: "Home is outside the fence." }]);
    expect(within(square(50), at(49, 49))).toBe(true);
    expect(outside(fence(square(50), square(90, true, 30, 0)), at(-49, 0))).toBeUndefined();
  });
});

describe("styles", () => {
  it("draw what layers are called, water above land and houses above roads", () => {
    const { layers } = styleOf({ url: "http://x/tiles", layers: ["buildings", "roads", "water", "earth", "boundaries"] }, true);
    const areas = layers.map((one) => one.id).filter((id) => id.endsWith("areas"));
    expect(areas).toEqual(["earth areas", "water areas", "roads areas", "buildings areas"]);
    expect(layers.map((one) => one.id)).toContain("boundaries lines");
  });

  it("draw pictures, and the ground alone where there are no tiles", () => {
    expect(styleOf({ url: "http://x/tiles", layers: undefined }, false).layers.map((one) => one.type)).toEqual(["background", "raster"]);
    expect(styleOf(undefined, false).layers).toHaveLength(1);
  });

  it("take the words alone of who made the tiles", () => {
    expect(wordsOf('<a href="https://x" onclick="y">&copy; People</a> &amp; others')).toBe("© People & others");
    expect(wordsOf(7)).toBe("");
  });
});
