import { Vector3 } from "three";
import { describe, expect, it } from "vitest";

import { caption, classOf, detectionsAsMarkers, polygonAsMarkers, posesAsMarkers } from "../src/lib/scene/asmarkers.ts";
import { Markers, MOST, MOST_POINTS } from "../src/lib/scene/markers.ts";

const WHITE = { r: 1, g: 1, b: 1, a: 1 };
const ONE = { x: 1, y: 1, z: 1 };
const cube = (more: object = {}): any => ({ header: { frame_id: "map" }, ns: "a", id: 1, type: 1, action: 0, scale: ONE, color: WHITE, pose: { position: { x: 1, y: 2, z: 3 }, orientation: { x: 0, y: 0, z: 0, w: 0 } }, ...more });
const points = (count: number): any[] => Array.from({ length: count }, (_, at) => ({ x: at, y: 0, z: 0 }));
const took = (...markers: any[]): Markers => {
  const made = new Markers();
  made.take({ markers }, 0);
  return made;
};

describe("markers", () => {
  it("are kept by namespace and number, and replaced", () => {
    const store = took(cube(), cube({ id: 2 }), cube({ ns: "b" }), cube({ pose: { position: { x: 9, y: 0, z: 0 } } }));
    expect([...store.all.keys()]).toEqual(["a/2", "b/1", "a/1"]);
    expect(new Vector3().setFromMatrixPosition(store.all.get("a/1")!.pose).toArray()).toEqual([9, 0, 0]);
  });

  it("are deleted one by one or all, and may come alone", () => {
    const store = took(cube(), cube({ id: 2 }), cube({ id: 3 }));
    store.take({ ns: "a", id: 2, action: 2 }, 0);
    expect([...store.all.keys()]).toEqual(["a/1", "a/3"]);
    store.take({ action: 3 }, 0);
    expect(store.all.size).toBe(0);
    store.take(cube(), 0);
    expect(store.all.size).toBe(1);
  });

  it("are deleted all of a namespace, where one is told", () => {
    const store = took(cube(), cube({ id: 2 }), cube({ ns: "a/b" }), cube({ ns: "b", type: 99 }));
    store.take({ ns: "a", action: 3 }, 0);
    expect([...store.all.keys()]).toEqual(["a/b/1"]);
    expect(store.problems).toHaveLength(1);
    store.take({ ns: "b", action: 3 }, 0);
    expect(store.problems).toEqual([]);
  });

  it("end when their lifetime is over, counted from when they came", () => {
    const store = new Markers();
    store.take({ markers: [cube({ lifetime: { sec: 1, nanosec: 500_000_000 } }), cube({ id: 2, lifetime: { sec: 0, nanosec: 0 } })] }, 1000);
    expect(store.next).toBe(2500);
    expect(store.expire(2499)).toBe(false);
    expect(store.expire(2500)).toBe(true);
    expect([...store.all.keys()]).toEqual(["a/2"]);
    expect(store.next).toBe(Infinity);
  });

  it("without a rotation stand straight, and with one of another length are as large", () => {
    const turned = cube({ pose: { position: { x: 0, y: 0, z: 0 }, orientation: { x: 0, y: 0, z: 5, w: 5 } } });
    const [straight, left] = [took(cube()).all.get("a/1")!, took(turned).all.get("a/1")!];
    expect(new Vector3(1, 0, 0).transformDirection(straight.pose).x).toBeCloseTo(1);
    const along = new Vector3(1, 0, 0).applyMatrix4(left.pose);
    expect([along.x, along.y]).toEqual([expect.closeTo(0), expect.closeTo(1)]);
  });

  it.each([
    [{ type: 42 }, "unknown type 42"],
    [{ type: "cube" }, "unknown type cube"],
    [{ type: undefined }, "unknown type undefined"],
    [{ action: 7 }, "unknown action 7"],
    [{ pose: { position: { x: NaN, y: 0, z: 0 } } }, "its pose has something that is not a number"],
    [{ pose: { position: { x: 0, y: 0, z: 0 }, orientation: { x: 0, y: 0, z: 0, w: "NaN" } } }, "its pose has something"],
    [{ pose: { position: { x: 1e300, y: 0, z: 0 } } }, "or is too far away"],
    [{ scale: { x: 1e300, y: 1, z: 1 } }, "or is too large"],
    [{ scale: { x: 1, y: -1, z: 1 } }, "its scale is negative"],
    [{ scale: { x: 1, y: 0, z: 1 } }, "its scale is zero in y"],
    [{ scale: { x: Infinity, y: 1, z: 1 } }, "its scale has something"],
    [{ color: { r: NaN, g: 0, b: 0, a: 1 } }, "its colour has something"],
    [{ type: 4 }, "it has no points"],
    [{ type: 8, points: "many" }, "it has no points"],
    [{ type: 5, points: points(3) }, "the number of its points, 3, is no multiple of 2"],
    [{ type: 11, points: points(4) }, "is no multiple of 3"],
    [{ type: 0, points: points(3) }, "an arrow has 2 points or none, and this has 3"],
    [{ type: 10 }, "it names no mesh_resource"],
  ])("that are wrong are named and not drawn, and leave the others: %o", (wrong, why) => {
    const store = took(cube({ id: 5, ...wrong }), cube());
    expect([...store.all.keys()]).toEqual(["a/1"]);
    expect(store.problems.join()).toContain("a/5");
    expect(store.problems.join()).toContain(why);
    store.take(cube({ id: 5 }), 0);
    expect(store.problems).toEqual([]);
  });

  it("that are no markers at all are refused", () => {
    expect(() => new Markers().take({ markers: 7 }, 0)).toThrow("it has no markers");
    expect(took(null, 5, "x", []).problems).toHaveLength(1); // of one reason
  });

  it("tell what of them is left out", () => {
    const store = took(
      cube({ type: 8, points: [...points(2), { x: 1e300, y: 0, z: 0 }] }),
      cube({ id: 2, color: { r: 1, g: 1, b: 1, a: 0 } }),
      cube({ id: 3, type: 8, points: points(3), colors: [WHITE] }),
    );
    expect(store.all.size).toBe(3);
    expect(store.problems).toEqual([
      "a/1: a point that is no number is left out",
      "a/2: it is fully transparent: its colour has alpha 0",
      "a/3: 1 colours do not fit 3 points: its own colour is used",
    ]);
  });

  it("are bounded in number, and what is deleted makes room", () => {
    const store = took(...Array.from({ length: MOST + 2 }, (_, id) => cube({ id })));
    expect(store.all.size).toBe(MOST);
    expect(store.problems[0]).toBe("2 markers are not drawn: 5,000 is the most");
    store.take({ markers: [{ ns: "a", id: 0, action: 2 }, cube({ id: MOST + 1 })] }, 0);
    expect(store.all.size).toBe(MOST);
    expect(store.problems[0]).toBe("1 marker is not drawn: 5,000 is the most");
  });

  it("are bounded in points, of all of them together", () => {
    const store = took(cube({ type: 5, points: points(MOST_POINTS - 3), scale: ONE }), cube({ id: 2, type: 5, points: points(10) }));
    expect(store.all.size).toBe(1); // an odd number of points
    store.take({ markers: [{ action: 3 }, cube({ type: 5, points: points(MOST_POINTS - 4) }), cube({ id: 2, type: 5, points: points(10) })] }, 0);
    expect(store.all.get("a/2")!.points).toHaveLength(4 * 3);
    expect(store.problems[0]).toContain("4 of 10 points are drawn");
    store.take({ ns: "a", id: 1, action: 2 }, 0);
    store.take(cube({ id: 2, type: 5, points: points(10) }), 0);
    expect(store.problems).toEqual([]);
  });

  it("have a colour for each point, or for each triangle", () => {
    const red = { r: 1, g: 0, b: 0, a: 0.5 };
    const store = took(cube({ type: 11, points: points(6), colors: [red, WHITE] }));
    expect([...store.all.get("a/1")!.colours!.subarray(8, 16)]).toEqual([1, 0, 0, 0.5, 1, 1, 1, 1]);
  });
});

describe("what is drawn as markers", () => {
  const drawn = (value: any): Markers => {
    const store = new Markers();
    store.take(value, 0);
    return store;
  };

  it("is an arrow for each pose, and an outline that closes", () => {
    const pose = { position: { x: 1, y: 0, z: 0 } };
    expect(drawn(posesAsMarkers({ header: { frame_id: "map" }, poses: [pose, pose] })).all.size).toBe(2);
    const [outline] = drawn(polygonAsMarkers({ polygon: { points: points(3) } })).all.values();
    expect(outline!.points).toHaveLength(4 * 3);
    expect(() => posesAsMarkers({})).toThrow("it has no poses");
    expect(() => polygonAsMarkers({ polygon: null })).toThrow("it has no points");
  });

  it("is a box with its class and score for each detection", () => {
    const bbox = { center: { position: { x: 1, y: 2, z: 3 } }, size: { x: 1, y: 1, z: 2 } };
    const results = [{ hypothesis: { class_id: "cat", score: 0.1 } }, { hypothesis: { class_id: "dog", score: 0.876 } }];
    const store = drawn(detectionsAsMarkers({ header: { frame_id: "map" }, detections: [{ bbox, results }, { bbox: {}, results: null }] }));
    const [box, text] = [...store.all.values()];
    expect(box!.ns).toBe("dog");
    expect(box!.points).toHaveLength(24 * 3);
    expect(text!.text).toBe("dog 88 %");
    expect([...store.all.values()]).toHaveLength(3);
    expect(store.problems.join()).toContain("24 points that are no numbers are left out");
    expect(() => detectionsAsMarkers({ detections: 3 })).toThrow("it has no detections");
  });

  it("knows the classes of either version of the message", () => {
    expect(caption(classOf({ results: [{ id: "7", score: 1 }] }))).toBe("7 100 %");
    expect(caption(classOf({ results: [{ hypothesis: { class_id: "cone", score: NaN } }] }))).toBe("cone");
    expect(caption(classOf({}))).toBe("unknown");
  });
});
