/** The mission and the fence of one robot: as it has them, and as they are being drawn. */
import { type Resource, RcpError } from "rcp-client";

import { app } from "../app.svelte.ts";
import type { Geo } from "../geo.ts";
import type { Robot } from "../robots.ts";
import { EMPTY, type Fence, fenceOf, type Item, itemsOf, moved, placed, placeFor, sideFor, whole } from "./items.ts";
import type { Plane } from "./plane.ts";

const STEPS = 50; // that can be undone

/** What a robot offers for its mission and fence, as far as the role may use it. */
export interface Offers {
  upload: Resource | undefined;
  run: Resource | undefined;
  pause: Resource | undefined;
  resume: Resource | undefined;
  download: Resource | undefined;
  uploadFence: Resource | undefined;
  downloadFence: Resource | undefined;
  exportFile: Resource | undefined;
  loadFile: Resource | undefined;
  progress: Resource | undefined;
  vehicle: Resource | undefined;
  mode: Resource | undefined;
  /** Whether an ArduPilot heeds its fence. */
  enabled: Resource | undefined;
}

export function offersOf(robot: Robot): Offers {
  const able = (name: string, operation: "execute" | "subscribe"): Resource | undefined =>
    robot.resources.find((one) => one.path.endsWith(`/${name}`) && (one.operations as string[]).includes(operation));
  return {
    upload: able("mission/upload", "execute"),
    run: able("mission/run", "execute"),
    pause: able("mission/pause", "execute"),
    resume: able("mission/resume", "execute"),
    download: able("mission/download", "execute"),
    uploadFence: able("fence/upload", "execute"),
    downloadFence: able("fence/download", "execute"),
    exportFile: able("plan/export", "execute"),
    loadFile: able("plan/load", "execute"),
    progress: able("sensor/mission", "subscribe") ?? robot.resources.find((one) => one.kind === "sensor" && one.native === "MISSION_CURRENT"),
    vehicle: robot.resources.find((one) => one.kind === "sensor" && one.path.endsWith("/vehicle")),
    mode: robot.resources.find((one) => one.kind === "sensor" && one.path.endsWith("/mode") && one.operations.includes("subscribe")),
    enabled: able("FENCE_ENABLE", "subscribe"),
  };
}

/** Whether there is a mission or a fence to show of it. */
export function plannable(robot: Robot): boolean {
  const { download, upload, downloadFence, uploadFence } = offersOf(robot);
  return [download, upload, downloadFence, uploadFence].some((one) => one !== undefined);
}

export function canFly(robot: Robot): boolean {
  return robot.resources.some((one) => one.path.endsWith("/takeoff"));
}

export type Handle = { what: "mission"; item: number } | { what: "fence"; area: number; corner: number };

interface Draft {
  mission: Item[] | undefined;
  fence: Fence | undefined;
}

export class Plan {
  readonly robot: string;
  /** As the robot has them; undefined while that is not known. */
  mission = $state.raw<Item[]>();
  fence = $state.raw<Fence>();
  /** As they are being drawn; undefined where nobody draws. */
  draft = $state.raw<Draft>({ mission: undefined, fence: undefined });
  reading = $state(false);
  #pending: Promise<void> | undefined;
  /** Why they could not be read. */
  error = $state.raw<RcpError>();
  selected = $state.raw<Handle>();
  shownMission = $derived(this.draft.mission ?? this.mission ?? []);
  shownFence = $derived(this.draft.fence ?? this.fence ?? EMPTY);
  #before = $state.raw<Draft[]>([]);
  mayUndo = $derived(this.#before.length > 0);
  /** What stood before a handle was dragged. */
  #dragged: Draft | undefined;

  constructor(robot: string) {
    this.robot = robot;
  }

  /** Ask the robot for what it has; one that is being asked already is waited for. */
  read(offers: Offers): Promise<void> {
    this.#pending ??= this.#read(offers).finally(() => (this.#pending = undefined));
    return this.#pending;
  }

  async #read(offers: Offers): Promise<void> {
    this.reading = true;
    this.error = undefined;
    try {
      const get = async (one: Resource): Promise<Item[]> => ((await app.client.execute(one.path).result) as { items: Item[] }).items.map(whole);
      if (offers.download) this.mission = await get(offers.download);
      if (offers.downloadFence) this.fence = fenceOf(await get(offers.downloadFence));
    } catch (error) {
      this.error = error instanceof RcpError ? error : new RcpError({ code: "internal", message: String(error) });
    } finally {
      this.reading = false;
    }
  }

  #change(next: Partial<Draft>): void {
    this.#before = [...this.#before.slice(1 - STEPS), this.draft];
    this.draft = { ...this.draft, ...next };
  }

  /** Begin to draw, from what the robot has. */
  begin(what: keyof Draft): void {
    if (this.draft[what]) return;
    this.#change(what === "mission" ? { mission: this.shownMission } : { fence: this.shownFence });
  }

  setMission(mission: Item[]): void {
    this.#change({ mission });
  }

  setFence(fence: Fence): void {
    this.#change({ fence });
  }

  undo(): void {
    const last = this.#before.at(-1);
    if (!last) return;
    this.#before = this.#before.slice(0, -1);
    this.draft = last;
    this.selected = undefined;
  }

  /** Draw no more: what the robot has is shown again. */
  discard(what: keyof Draft): void {
    this.draft = { ...this.draft, [what]: undefined };
    this.#before = [];
    this.selected = undefined;
  }

  /** Add an item where it belongs. */
  add(item: Item): void {
    const items = this.shownMission;
    const after = placeFor(items, item, this.selected?.what === "mission" ? this.selected.item : undefined);
    this.setMission([...items.slice(0, after), item, ...items.slice(after)]);
    this.selected = { what: "mission", item: after };
  }

  changeItem(place: number, change: Partial<Item>): void {
    this.setMission(this.shownMission.map((one, at) => (at === place ? { ...one, ...change } : one)));
  }

  moveItem(place: number, to: number): void {
    this.setMission(moved(this.shownMission, place, to));
    this.selected = { what: "mission", item: Math.min(this.shownMission.length - 1, Math.max(0, to)) };
  }

  removeItem(place: number): void {
    this.setMission(this.shownMission.filter((_, at) => at !== place));
    this.selected = undefined;
  }

  /** Add a corner after the one that is selected, else into the nearest side of the last area; or begin one. */
  addCorner(at: Geo): void {
    const { areas, rest } = this.shownFence;
    const chosen = this.selected?.what === "fence" ? this.selected.area : areas.length - 1;
    const area = areas[chosen];
    if (!area || area.radius !== undefined) return this.addArea({ inside: true, corners: [at] });
    const corner = this.selected?.what === "fence" ? this.selected.corner + 1 : sideFor(area.corners, at);
    const corners = [...area.corners.slice(0, corner), at, ...area.corners.slice(corner)];
    this.setFence({ areas: areas.map((one, place) => (place === chosen ? { ...one, corners } : one)), rest });
    this.selected = { what: "fence", area: chosen, corner };
  }

  addArea(area: Fence["areas"][number]): void {
    const { areas, rest } = this.shownFence;
    this.setFence({ areas: [...areas, area], rest });
    this.selected = { what: "fence", area: areas.length, corner: 0 };
  }

  changeArea(place: number, change: Partial<Fence["areas"][number]>): void {
    const { areas, rest } = this.shownFence;
    this.setFence({ areas: areas.map((one, at) => (at === place ? { ...one, ...change } : one)), rest });
  }

  removeArea(place: number): void {
    const { areas, rest } = this.shownFence;
    this.setFence({ areas: areas.filter((_, at) => at !== place), rest });
    this.selected = undefined;
  }

  removeCorner(area: number, corner: number): void {
    const found = this.shownFence.areas[area];
    if (!found) return;
    if (found.corners.length === 1) return this.removeArea(area);
    this.changeArea(area, { corners: found.corners.filter((_, at) => at !== corner) });
    this.selected = undefined;
  }

  removeSelected(): void {
    const one = this.selected;
    if (one?.what === "mission") this.removeItem(one.item);
    else if (one) this.removeCorner(one.area, one.corner);
  }

  /** The handles of what is being drawn, with their places. */
  *handles(what: keyof Draft): Generator<[Handle, Geo]> {
    if (what === "mission") for (const [item, one] of this.shownMission.entries()) if (placed(one)) yield [{ what, item }, one];
    if (what === "fence") for (const [area, { corners }] of this.shownFence.areas.entries()) for (const [corner, at] of corners.entries()) yield [{ what, area, corner }, at];
  }

  /** The handle that is nearest to a pixel, within reach of it. */
  near(what: keyof Draft, plane: Plane, px: number, py: number, reach: number): Handle | undefined {
    let best: { handle: Handle; far: number } | undefined;
    for (const [handle, at] of this.handles(what)) {
      const [x, y] = plane.toScreen(at);
      const far = Math.hypot(x - px, y - py);
      if (far < reach && far <= (best?.far ?? Infinity)) best = { handle, far };
    }
    return best?.handle;
  }

  /** Move a handle along with the pointer; it is one change, until it is dropped. */
  drag(handle: Handle, at: Geo): void {
    this.#dragged ??= this.draft;
    const place = { latitude: at.latitude, longitude: at.longitude };
    if (handle.what === "mission") {
      this.draft = { ...this.draft, mission: this.shownMission.map((one, item) => (item === handle.item ? { ...one, ...place } : one)) };
      return;
    }
    const { areas, rest } = this.shownFence;
    const change = (corners: Geo[]): Geo[] => corners.map((one, corner) => (corner === handle.corner ? place : one));
    this.draft = { ...this.draft, fence: { areas: areas.map((one, area) => (area === handle.area ? { ...one, corners: change(one.corners) } : one)), rest } };
  }

  drop(): void {
    if (this.#dragged) this.#before = [...this.#before.slice(1 - STEPS), this.#dragged];
    this.#dragged = undefined;
  }

  /** Put what is being dragged back. */
  undrag(): void {
    if (this.#dragged) this.draft = this.#dragged;
    this.#dragged = undefined;
  }

  /** What is to be sent. */
  items(what: keyof Draft): Item[] {
    return what === "mission" ? this.shownMission : itemsOf(this.shownFence);
  }
}

const plans = new Map<string, Plan>();
let epoch: number | undefined;

/** The plan of a robot, which outlives the page that shows it, and not the login: what was drawn is not lost by looking elsewhere. */
export function planOf(robot: string): Plan {
  if (epoch !== app.epoch) plans.clear();
  epoch = app.epoch;
  let found = plans.get(robot);
  if (!found) plans.set(robot, (found = new Plan(robot)));
  return found;
}
