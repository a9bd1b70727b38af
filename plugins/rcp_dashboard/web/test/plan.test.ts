import { type Resource, RcpError } from "rcp-client";
import { describe, expect, it } from "vitest";

import { Checking } from "../src/lib/map/checking.svelte.ts";
import { EMPTY, type Fence, type Item, itemsOf, sameFence, sameItems, waypoint } from "../src/lib/map/items.ts";
import { type Offers, Plan } from "../src/lib/map/plan.svelte.ts";

const HOME = { latitude: -35.3632621, longitude: 149.1652374 };
const mission = (...heights: number[]): Item[] => heights.map((one) => waypoint(HOME, one));
const circle = (radius: number): Fence => ({ areas: [{ inside: true, corners: [HOME], radius }], rest: [] });
const OFFERS = { download: { path: "mission" } as Resource, downloadFence: { path: "fence" } as Resource } as Offers;

/** A vehicle that answers when it is let. */
class Vehicle {
  has: Record<string, Item[]> = { mission: mission(5), fence: itemsOf(circle(50)) };
  silent = "";
  asked: string[] = [];
  #held: (() => void)[] | undefined;

  readonly ask = async (path: string): Promise<unknown> => {
    this.asked.push(path);
    const items = this.has[path];
    if (this.#held) await new Promise<void>((go) => this.#held!.push(go));
    if (path === this.silent) throw new RcpError({ code: "device_timeout", message: "no answer" });
    return { items };
  };
  /** Keep answers, of what was known when it was asked, until they are let go. */
  hold(): void {
    this.#held = [];
  }
  go(): void {
    const held = this.#held ?? [];
    this.#held = undefined;
    held.forEach((one) => one());
  }
}

function known(): [Plan, Vehicle] {
  const vehicle = new Vehicle();
  return [new Plan("drone", vehicle.ask), vehicle];
}

describe("what a vehicle has", () => {
  it("is not known until it is read, and not known any more once it is forgotten", async () => {
    const [plan, vehicle] = known();
    expect([plan.mission, plan.fence]).toEqual([undefined, undefined]);
    await plan.read(OFFERS);
    expect([plan.mission, plan.fence]).toEqual([mission(5), circle(50)]);
    vehicle.hold();
    const late = plan.read(OFFERS);
    plan.forget();
    vehicle.go();
    await late;
    expect([plan.mission, plan.fence]).toEqual([undefined, undefined]);
  });

  it("is read half where one half does not answer", async () => {
    const [plan, vehicle] = known();
    vehicle.silent = "mission";
    await plan.read(OFFERS);
    expect([plan.mission, plan.fence]).toEqual([undefined, circle(50)]);
    expect([plan.errors.mission?.code, plan.errors.fence]).toEqual(["device_timeout", undefined]);
  });

  it("is read again where another plan is reported, once", async () => {
    const [plan, vehicle] = known();
    await plan.read(OFFERS);
    const began = async (report: object): Promise<boolean> => {
      plan.heed(report, OFFERS);
      const reading = plan.reading;
      await (reading ? plan.read(OFFERS) : undefined);
      return reading;
    };
    expect(await began({ total: 3 })).toBe(true);
    expect(await began({ total: 3 })).toBe(false);
    expect(await began({ total: 3, mission_id: 7 })).toBe(true);
    expect(await began({ total: 3, mission_id: 7, fence_id: 2 })).toBe(true);
    plan.forget();
    await plan.read(OFFERS);
    expect(await began({ total: 1, mission_id: 7 })).toBe(false);
    expect(await began({ total: 65_535 })).toBe(true);
    plan.forget();
    await plan.read(OFFERS);
    expect(await began({ total: 0, mission_state: "MISSION_STATE_NO_MISSION" })).toBe(true);
  });

  it("is not run where it is another mission than is shown", async () => {
    const [plan, vehicle] = known();
    await plan.read(OFFERS);
    expect(await plan.verify(OFFERS)).toBeUndefined();
    expect((await plan.verify(OFFERS, mission(4)))?.message).toContain("another mission than was shown");
    vehicle.has["mission"] = mission(6);
    expect((await plan.verify(OFFERS))?.message).toContain("another mission than was shown");
    expect(plan.mission).toEqual(mission(6));
    vehicle.silent = "mission";
    expect((await plan.verify(OFFERS))?.code).toBe("device_timeout");
  });
});

describe("what is drawn", () => {
  it("is not drawn over what is not known, unless that is to be replaced", async () => {
    const [plan, vehicle] = known();
    vehicle.silent = "fence";
    await plan.read(OFFERS);
    expect([plan.begin("mission"), plan.begin("fence")]).toEqual([true, false]);
    plan.addCorner(HOME);
    plan.addArea({ inside: true, corners: [HOME], radius: 9 });
    expect(plan.draft.fence).toBeUndefined();
    plan.replace("fence");
    plan.addCorner(HOME);
    expect(plan.draft.fence?.areas).toHaveLength(1);
  });

  it("stays until what was read after the upload is what was sent", async () => {
    const [plan, vehicle] = known();
    await plan.read(OFFERS);
    plan.begin("mission");
    plan.add(waypoint(HOME, 9));
    const sent = plan.draft;
    vehicle.hold();
    const early = plan.read(OFFERS); // of before the upload
    vehicle.has["mission"] = mission(5, 9);
    const confirmed = plan.confirm("mission", sent, OFFERS);
    vehicle.go();
    await early;
    expect(plan.draft.mission).toBeDefined();
    expect(await confirmed).toBeUndefined();
    expect([plan.draft.mission, plan.mission]).toEqual([undefined, mission(5, 9)]);
  });

  it("is kept where the vehicle has something else, or it was changed meanwhile", async () => {
    const [plan, vehicle] = known();
    await plan.read(OFFERS);
    plan.begin("mission");
    plan.add(waypoint(HOME, 9));
    expect((await plan.confirm("mission", plan.draft, OFFERS))?.message).toContain("another mission than was uploaded");
    expect(plan.draft.mission).toHaveLength(2);
    const sent = plan.draft;
    vehicle.has["mission"] = plan.items("mission");
    plan.removeItem(0);
    expect(await plan.confirm("mission", sent, OFFERS)).toBeUndefined();
    expect(plan.draft.mission).toHaveLength(1);
  });

  it("is given up for a file where that has changed what the vehicle has, and kept elsewhere", async () => {
    const [plan, vehicle] = known();
    await plan.read(OFFERS);
    plan.begin("mission");
    plan.begin("fence");
    const loaded = plan.loading(OFFERS);
    vehicle.has["mission"] = mission(7);
    await loaded();
    expect([plan.draft.mission, plan.draft.fence]).toEqual([undefined, circle(50)]);
  });

  it("is compared as vehicles round", () => {
    const close = { latitude: HOME.latitude + 4e-8, longitude: HOME.longitude };
    expect(sameItems([waypoint(HOME, 5)], [waypoint(close, 5.000_001)])).toBe(true);
    expect(sameItems([waypoint(HOME, 5)], [waypoint(HOME, 0)])).toBe(false);
    expect(sameItems([waypoint(HOME, 5)], [{ ...waypoint(HOME, 5), frame: "absolute" }])).toBe(false);
    expect(sameItems([waypoint(HOME, 5)], [])).toBe(false);
    expect(sameFence(circle(50), circle(50.000_001))).toBe(true);
    expect(sameFence(circle(50), circle(60))).toBe(false);
    expect(sameFence(circle(50), EMPTY)).toBe(false);
  });
});

describe("a check", () => {
  it("tells what it was asked of, and nothing once something else is shown", async () => {
    let shown: unknown[] = ["draft", "mission"];
    const checking = new Checking(() => shown);
    await checking.ask(() => Promise.resolve(), "fine");
    expect(checking.words).toBe("fine");
    let answer!: (error: RcpError | undefined) => void;
    const later = (): Promise<void> => new Promise((done, fail) => (answer = (error) => (error ? fail(error) : done())));
    for (const error of [undefined, new RcpError({ code: "out_of_range", message: "too high" })]) {
      shown = ["draft", "mission"];
      const asked = checking.ask(later, "fine");
      shown = ["draft", "fence"];
      checking.clear();
      answer(error);
      await asked;
      expect([checking.words, checking.refused]).toEqual(["", undefined]);
    }
    const asked = checking.ask(later, "fine");
    answer(new RcpError({ code: "out_of_range", message: "too high" }));
    await asked;
    expect(checking.refused?.code).toBe("out_of_range");
  });
});
