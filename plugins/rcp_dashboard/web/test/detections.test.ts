import type { Resource } from "rcp-client";
import { describe, expect, it } from "vitest";

import { belongs, foundIn, MOST } from "../src/lib/detections.ts";
import { ofShape } from "../src/lib/shapes.ts";

const box = (more: object = {}): any => ({ bbox: { center: { position: { x: 5, y: 6 }, theta: 0 }, size_x: 2, size_y: 4, ...more }, results: [{ hypothesis: { class_id: "cone", score: 0.5 } }] });
const resource = (path: string, properties: Record<string, unknown> = {}): Resource => ({ path, kind: "sensor", operations: ["subscribe"], schemas: { value: { type: "object", properties } } }) as unknown as Resource;
const list = (properties: Record<string, unknown>): object => ({ type: "array", items: { type: "object", properties } });

describe("what was detected in an image", () => {
  it("has boxes with class and score", () => {
    expect(foundIn({ detections: [box()] })).toEqual({ boxes: [{ x: 5, y: 6, width: 2, height: 4, turned: 0, text: "cone 50 %", hue: expect.anything() }], problem: "" });
    expect(foundIn({ detections: [box({ center: { x: 1, y: 2, theta: 0.1 } })] }).boxes[0]).toMatchObject({ x: 1, y: 2, turned: 0.1 });
  });

  it("is named where it is wrong, and bounded", () => {
    expect(foundIn({ detections: [box({ size_x: -1 }), box({ center: null }), {}, null, box()] })).toMatchObject({ boxes: [{ x: 5 }], problem: "4 boxes are not drawn: no number, or a negative size" });
    expect(foundIn({ detections: "x" }).problem).toBe("it has no detections");
    const many = foundIn({ detections: Array.from({ length: MOST + 1 }, () => box()) });
    expect([many.boxes.length, many.problem]).toEqual([MOST, "1 more box is not drawn: 200 is the most"]);
  });

  it("belongs to the camera of its frame, else to the one beside it or the only one", () => {
    const side = (path: string, frame_id?: string): any => ({ resource: resource(path), value: frame_id ? { header: { frame_id } } : {} });
    expect(belongs(side("/a/left/image", "left"), side("/a/found", "left"), false)).toBe(true);
    expect(belongs(side("/a/left/image", "left"), side("/a/left/found", "right"), true)).toBe(false);
    expect(belongs(side("/a/left/image"), side("/a/left/found"), false)).toBe(true);
    expect(belongs(side("/a/left/image"), side("/a/right/found"), false)).toBe(false);
    expect(belongs(side("/a/left/image"), side("/a/found"), true)).toBe(true);
  });
});

describe("shapes", () => {
  const any = {};
  it.each([
    ["markers", { markers: list({ ns: any, type: any, pose: any }) }],
    ["markers", { header: any, ns: any, id: any, type: any, action: any, pose: any, scale: any, points: any }],
    ["detections", { detections: list({ bbox: any }) }],
    ["detections2d", { detections: list({ bbox: { type: "object", properties: { size_x: any } } }) }],
    ["gridUpdate", { header: any, x: any, y: any, width: any, height: any, data: any }],
    ["poses", { poses: list({ position: any, orientation: any }) }],
    ["path", { poses: list({ header: any, pose: any }) }],
    ["path", { poses: any }],
    ["polygon", { header: any, polygon: any }],
  ] as const)("a %s is known by its fields, and taken for nothing else", (shape, properties) => {
    const one = resource("/tenant/a/sensor/x", properties);
    const others = ["markers", "detections", "detections2d", "gridUpdate", "poses", "path", "polygon", "pose", "cloud", "image", "grid"] as const;
    expect(others.filter((other) => ofShape([one], other).length > 0)).toEqual([shape]);
  });

  it("markers of something else are none", () => {
    expect(ofShape([resource("/tenant/a/sensor/x", { markers: list({ id: any, confidence: any }) })], "markers")).toEqual([]);
  });
});
