/** The mission and the fence of one robot: as it has them, and as they are being drawn. */
import { type Resource, RcpError } from "rcp-client";

import { say } from "../language.svelte.ts";
import type { Geo } from "../geo.ts";
import type { Robot } from "../robots.ts";
import { EMPTY, type Fence, fenceOf, type Item, itemsOf, moved, placed, placeFor, sameFence, sameItems, sideFor, whole } from "./items.ts";
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

/** What a vehicle reports of the plan that it has (MISSION_CURRENT). */
export interface Report {
  total?: number;
  mission_state?: string | number;
  mission_id?: number;
  fence_id?: number;
}

const NONE: Item[] = [];
const NO_MISSION = 65_535; // of `total`; 0: it tells none

export type Handle = { what: "mission"; item: number } | { what: "fence"; area: number; corner: number };

interface Draft {
  mission: Item[] | undefined;
  fence: Fence | undefined;
}

type What = keyof Draft;
type Ask = (path: string) => Promise<unknown>;

export class Plan {
  readonly robot: string;
  /** As the robot has them; undefined while that is not known. */
  mission = $state.raw<Item[]>();
  fence = $state.raw<Fence>();
  /** As they are being drawn; undefined where nobody draws. */
  draft = $state.raw<Draft>({ mission: undefined, fence: undefined });
  reading = $state(false);
  /** Why they could not be read. */
  errors = $state.raw<Partial<Record<What, RcpError>>>({});
  readonly #ask: Ask;
  #pending: Promise<void> | undefined;
  #next: Promise<void> | undefined;
  /** Rises when what is being read is no longer to be taken. */
  #turn = 0;
  /** What was reported of the plan that was read, or is being read. */
  #reported: string | undefined;
  selected = $state.raw<Handle>();
  #before = $state.raw<Draft[]>([]);
  /** What stood before a handle was dragged. */
  #dragged: Draft | undefined;

  /** Take the robot's name, and what executes a service that only reads. */
  constructor(robot: string, ask: Ask) {
    this.robot = robot;
    this.#ask = ask;
  }

  // No deriveds: these would end with the component that made the plan first, and the plan outlives it.
  get shownMission(): Item[] {
    return this.draft.mission ?? this.mission ?? NONE;
  }
  get shownFence(): Fence {
    return this.draft.fence ?? this.fence ?? EMPTY;
  }
  get mayUndo(): boolean {
    return this.#before.length > 0;
  }

  /** Know nothing of what the robot has, until it is read; what is drawn stays. */
  forget(): void {
    this.#turn += 1;
    this.mission = this.fence = undefined;
    this.errors = {};
    this.#reported = undefined;
  }

  /** Ask the robot for what it has; one that is being asked already is waited for. */
  read(offers: Offers): Promise<void> {
    this.#pending ??= this.#read(offers).finally(() => (this.#pending = undefined));
    return this.#pending;
  }

  /** Ask the robot after this moment: what is being read may be of before it. */
  readAnew(offers: Offers): Promise<void> {
    if (!this.#pending) return this.read(offers);
    this.#next ??= this.#pending.then(() => {
      this.#next = undefined;
      return this.read(offers);
    });
    return this.#next;
  }

  async #read({ download, downloadFence }: Offers): Promise<void> {
    const turn = this.#turn;
    this.reading = true;
    this.errors = {};
    const get = async (what: What, one: Resource): Promise<Item[] | undefined> => {
      try {
        return ((await this.#ask(one.path)) as { items: Item[] }).items.map(whole);
      } catch (error) {
        if (turn === this.#turn) this.errors = { ...this.errors, [what]: error instanceof RcpError ? error : new RcpError({ code: "internal", message: String(error) }) };
        return undefined;
      }
    };
    const mission = download && (await get("mission", download));
    if (turn === this.#turn) this.mission = mission;
    const fence = downloadFence && (await get("fence", downloadFence));
    if (turn === this.#turn) this.fence = fence && fenceOf(fence);
    this.reading = false;
  }

  /** Read again where a report tells of another plan than the one that was read. */
  heed(report: Report, offers: Offers): void {
    const { total = 0, mission_state, mission_id = 0, fence_id = 0 } = report;
    const told = `${total} ${mission_id} ${fence_id}`;
    if (told === this.#reported || (this.#reported === undefined && this.reading)) return;
    const first = this.#reported === undefined;
    this.#reported = told;
    const none = total === NO_MISSION || /no_mission/i.test(String(mission_state));
    const count = none ? 0 : total || this.mission?.length;
    if (!first || (this.mission && count !== this.mission.length)) void this.readAnew(offers);
  }

  /** Read what an upload has left, and draw no more if that is what was sent; returns why not. */
  async confirm(what: What, sent: Draft, offers: Offers): Promise<RcpError | undefined> {
    let turn: number;
    do {
      turn = this.#turn;
      await this.readAnew(offers);
    } while (turn !== this.#turn); // it was forgotten meanwhile
    if (this.errors[what]) return undefined; // told of already
    const readable = what === "mission" ? offers.download : offers.downloadFence;
    const { mission, fence } = this;
    const known = what === "mission" ? mission : fence;
    const same = what === "mission" ? mission && sameItems(sent.mission ?? [], mission) : fence && sameFence(sent.fence ?? EMPTY, fence);
    if (known && !same) return new RcpError({ code: "differs", message: `the vehicle has another ${say(what)} than was uploaded`, remedy: "Upload it again, or press Discard to see what the vehicle has." });
    // What was changed meanwhile is not on board.
    if ((known || !readable) && this.draft[what] === sent[what]) this.discard(what);
    return undefined;
  }

  /** Note what there is before a file is loaded; returns what reads it again then, and draws no more of what has changed. */
  loading(offers: Offers): () => Promise<void> {
    const drawn = this.draft;
    const had = { mission: JSON.stringify(this.mission), fence: JSON.stringify(this.fence) };
    return async () => {
      await this.readAnew(offers);
      for (const what of ["mission", "fence"] as const) {
        const changed = this[what] && JSON.stringify(this[what]) !== had[what];
        if (changed && this.draft[what] && this.draft[what] === drawn[what]) this.discard(what);
      }
    };
  }

  /** Read the mission that is to be run; returns why it is not the one that is meant. */
  async verify(offers: Offers, meant = this.mission): Promise<RcpError | undefined> {
    await this.readAnew(offers);
    if (this.errors.mission) return this.errors.mission;
    if (!this.mission || JSON.stringify(this.mission) !== JSON.stringify(meant)) return new RcpError({ code: "not_sent", message: "the vehicle has another mission than was shown", remedy: "Look at the mission that is shown now, then run it." });
    return this.draft.mission && new RcpError({ code: "not_sent", message: "the mission was changed here and not uploaded", remedy: "Upload or discard it, then run it." });
  }

  #change(next: Partial<Draft>): void {
    this.#before = [...this.#before.slice(1 - STEPS), this.draft];
    this.draft = { ...this.draft, ...next };
  }

  /** Whether there is something to draw on: nothing that is not known is drawn over. */
  mayDraw(what: What): boolean {
    return this.draft[what] !== undefined || this[what] !== undefined;
  }

  /** Begin to draw, from what the robot has; returns whether that is known. */
  begin(what: What): boolean {
    if (!this.draft[what] && this.mayDraw(what)) this.#change({ [what]: this[what] });
    return this.mayDraw(what);
  }

  /** Begin to draw with nothing, in place of whatever the robot has. */
  replace(what: What): void {
    this.#change(what === "mission" ? { mission: [] } : { fence: EMPTY });
  }

  setMission(mission: Item[]): void {
    if (this.mayDraw("mission")) this.#change({ mission });
  }

  setFence(fence: Fence): void {
    if (this.mayDraw("fence")) this.#change({ fence });
  }

  undo(): void {
    const last = this.#before.at(-1);
    if (!last) return;
    this.#before = this.#before.slice(0, -1);
    this.draft = last;
    this.selected = undefined;
  }

  /** Draw no more: what the robot has is shown again. */
  discard(what: What): void {
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
  *handles(what: What): Generator<[Handle, Geo]> {
    if (what === "mission") for (const [item, one] of this.shownMission.entries()) if (placed(one)) yield [{ what, item }, one];
    if (what === "fence") for (const [area, { corners }] of this.shownFence.areas.entries()) for (const [corner, at] of corners.entries()) yield [{ what, area, corner }, at];
  }

  /** The handle that is nearest to a pixel, within reach of it. */
  near(what: What, plane: Plane, px: number, py: number, reach: number): Handle | undefined {
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
  items(what: What): Item[] {
    return what === "mission" ? this.shownMission : itemsOf(this.shownFence);
  }
}
