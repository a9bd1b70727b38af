/** The parameters of one robot: what they are, what is to be changed, and what came of writing it. */
import { type Item, RcpError } from "rcp-client";

import type { ParameterFile } from "./files.ts";
import type { Parameter } from "./parameter.ts";
import { boxText, type Entered, entered, same } from "./value.ts";
import { type Change, type Device, type Result, Writing } from "./writing.ts";

/** What is known of a value. */
export type Known = { value: unknown; error?: undefined } | { error: RcpError };

/** A change that has not been written; `from` is what the robot had when it was begun, undefined: not known. */
export type Pending = { text: string; from: unknown } & Entered;

/** How an editor reaches its robot. */
export interface Reach {
  device: Device;
  execute: (path: string) => Promise<unknown>;
  /** What the gateway knows of a value now. */
  look: (path: string) => Promise<unknown>;
  /** Read all of a pattern, page by page. */
  pages: (pattern: string) => AsyncIterable<Item[]>;
}

const NONE: ReadonlyMap<string, Pending> = new Map();
const AT_ONCE = 32; // values that are asked for together

export class Editor {
  values = $state.raw<ReadonlyMap<string, Known>>(new Map());
  pending = $state.raw<ReadonlyMap<string, Pending>>(NONE);
  reading = $state(false);
  /** Why they could not be read. */
  problem = $state.raw<RcpError>();
  /** Those that the robot has told when it was asked, by name; undefined: it was not asked. */
  defaults = $state.raw<ReadonlyMap<string, unknown>>();
  /** The file that they are compared with. */
  file = $state.raw<ParameterFile>();
  writing = $state.raw<Writing>();
  busy = $state(false);
  /** What the robot has now is asked for, before it is written over. */
  checking = $state(false);
  /** Rises whenever something of the writing has changed. */
  turn = $state(0);
  readonly #reach: Reach;
  #reads = 0;
  #takes = 0;
  /** In which of the takes each value came last. */
  readonly #taken = new Map<string, number>();
  /** Results of which the pending change was given up: what is entered afterwards is another one. */
  #settled = new WeakSet<Result>();

  constructor(reach: Reach) {
    this.#reach = reach;
  }

  // No deriveds: these would end with the component that made the editor first, and the editor outlives it.
  get faulty(): number {
    return [...this.pending.values()].filter((one) => one.fault !== undefined).length;
  }

  valueOf(path: string): unknown {
    const known = this.values.get(path);
    return known && known.error === undefined ? known.value : undefined;
  }

  /** Take values that the robot has reported. */
  take(found: Iterable<[path: string, known: Known]>): void {
    const values = new Map(this.values);
    this.#takes += 1;
    for (const [path, known] of found) {
      values.set(path, known);
      this.#taken.set(path, this.#takes);
    }
    this.values = values;
  }

  /** Forget what another gateway, or one that has begun anew, told of the robot; what was entered stays. */
  forget(): void {
    this.#reads += 1;
    this.reading = false;
    this.values = new Map();
    this.defaults = undefined;
  }

  /** Read all of them, as far as they are below this pattern. */
  async read(pattern: string, paths: ReadonlySet<string>): Promise<void> {
    const turn = ++this.#reads;
    const begun = this.#takes;
    // Reading all may take a slow robot long: what was written or told since then is newer.
    const wanted = (path: string): boolean => paths.has(path) && (this.#taken.get(path) ?? 0) <= begun;
    this.reading = true;
    this.problem = undefined;
    try {
      for await (const items of this.#reach.pages(pattern)) {
        if (turn !== this.#reads) return;
        this.take(items.filter((one) => wanted(one.path)).map((one) => [one.path, one.error ? { error: new RcpError(one.error) } : { value: one.body }]));
      }
    } catch (problem) {
      if (turn === this.#reads) this.problem = problem as RcpError;
    } finally {
      if (turn === this.#reads) this.reading = false;
    }
  }

  /** Ask services for the defaults; each is given with what is before its names. */
  async readDefaults(services: [path: string, prefix: string][]): Promise<void> {
    const found = new Map<string, unknown>();
    this.defaults = found;
    try {
      for (const [path, prefix] of services) {
        const { values } = (await this.#reach.execute(path)) as { values: Record<string, unknown> };
        for (const [name, value] of Object.entries(values)) found.set(prefix + name, value);
      }
      this.defaults = new Map(found);
    } catch (problem) {
      this.defaults = undefined;
      throw problem;
    }
  }

  /** Enter a value; what the robot has already is no change. */
  enter(one: Parameter, text: string): void {
    this.type(one, text);
    this.settle([one.path]);
  }

  /** Take what has been typed so far: it stays as it is, also where the robot happens to have that value, for the next digit belongs to it. */
  type(one: Parameter, text: string): void {
    this.#change([[one.path, this.#pendingOf(one, text)]]);
  }

  /** Give up changes to what the robot has already. */
  settle(paths: Iterable<string>): void {
    const none = [...paths].filter((path) => this.values.has(path) && isOf(this.pending.get(path), this.valueOf(path)));
    if (none.length) this.#change(none.map((path) => [path, undefined]));
  }

  #pendingOf(one: Parameter, text: string): Pending {
    const before = this.pending.get(one.path);
    return { text, from: before ? before.from : this.valueOf(one.path), ...entered(one, text) };
  }

  /** Enter several values, as of a file. */
  enterAll(all: Iterable<[one: Parameter, value: unknown]>): void {
    const chosen = [...all].filter(([one]) => one.writable);
    this.#change(chosen.map(([one, value]) => [one.path, this.#pendingOf(one, boxText(one, value))]));
    this.settle(chosen.map(([one]) => one.path));
  }

  /** As `#set`, by a person: what waits for an approval is not sent any more where it is not what is pending. */
  #change(changes: [path: string, pending: Pending | undefined][]): void {
    this.#set(changes);
    const { writing } = this;
    if (!writing?.waiting || this.busy || writing.left.every(({ path, value }) => isOf(this.pending.get(path), value))) return;
    writing.stop();
    this.turn += 1;
  }

  #set(changes: [path: string, pending: Pending | undefined][]): void {
    const pending = new Map(this.pending);
    for (const [path, change] of changes) {
      if (change) pending.set(path, change);
      else pending.delete(path);
    }
    this.pending = pending;
  }

  /** Give up a change, or all of them. */
  undo(path: string): void {
    this.#change([[path, undefined]]);
  }
  discard(): void {
    this.#change([...this.pending.keys()].map((path) => [path, undefined]));
  }

  /** Ask what the robot has now of what is pending; return those that somebody has changed since they were entered. */
  async overtaken(parameters: Parameter[]): Promise<Parameter[]> {
    const asked = parameters.filter((one) => this.pending.has(one.path) && one.resource.operations.includes("read"));
    this.checking = true;
    try {
      for (let at = 0; at < asked.length; at += AT_ONCE) {
        const found = await Promise.allSettled(asked.slice(at, at + AT_ONCE).map(async ({ path }): Promise<[string, Known]> => [path, { value: await this.#reach.look(path) }]));
        this.take(found.flatMap((one) => (one.status === "fulfilled" ? [one.value] : [])));
      }
    } finally {
      this.checking = false;
    }
    return asked.filter((one) => this.isOvertaken(one.path));
  }

  /** Whether the robot has another value than when the change was begun, nor the one that is to be written. */
  isOvertaken(path: string): boolean {
    const [pending, now] = [this.pending.get(path), this.valueOf(path)];
    return pending?.from !== undefined && now !== undefined && !same(now, pending.from) && !isOf(pending, now);
  }

  /** Write all that is pending; `parameters` in the order in which that is done. */
  async write(parameters: Parameter[]): Promise<void> {
    this.settle(this.pending.keys());
    if (this.busy || this.faulty) return;
    const changes: Change[] = parameters.flatMap((one) => {
      const pending = this.pending.get(one.path);
      return pending && pending.fault === undefined ? [{ path: one.path, name: one.name, before: this.valueOf(one.path), value: pending.value, atomic: one.resource.atomic }] : [];
    });
    if (changes.length === 0) return;
    const writing = new Writing(changes, this.#reach.device, () => this.#note(writing));
    this.writing = writing;
    await this.#run(() => writing.run());
  }

  /** Go on with what a person has approved. */
  async goOn(approval: string): Promise<void> {
    const writing = this.writing;
    if (writing?.waiting && !this.busy) await this.#run(() => writing.run(approval));
  }

  /** Ask the robot for what is not known of the last writing, as after a lost connection. */
  async readBack(): Promise<void> {
    const writing = this.writing;
    if (writing?.unread && !this.busy) await this.#run(() => writing.readBack());
  }

  async #run(what: () => Promise<void>): Promise<void> {
    this.busy = true;
    try {
      await what();
    } finally {
      this.busy = false;
      this.turn += 1;
    }
  }

  #note(writing: Writing): void {
    // Each once: somebody else may have changed it since.
    this.take([...writing.news()].map(([path, value]) => [path, { value }]));
    const settled = writing.results.filter((one) => (one.outcome === "written" || one.outcome === "other") && !this.#settled.has(one));
    for (const one of settled) this.#settled.add(one);
    // What was entered meanwhile is another change.
    this.#set(settled.filter(({ path, value }) => isOf(this.pending.get(path), value)).map(({ path }) => [path, undefined]));
    this.turn += 1;
  }

  /** Have the values of before pending again. */
  revert(parameters: Parameter[]): void {
    const byPath = new Map(parameters.map((one) => [one.path, one]));
    const results = this.writing?.results ?? [];
    this.enterAll(
      results.flatMap(({ path, outcome, before }): [Parameter, unknown][] => {
        const one = byPath.get(path);
        return one && before !== undefined && (outcome === "written" || outcome === "other") ? [[one, before]] : [];
      }),
    );
    this.writing = undefined;
  }
}

function isOf(pending: Pending | undefined, value: unknown): boolean {
  return pending !== undefined && pending.fault === undefined && same(pending.value, value);
}
