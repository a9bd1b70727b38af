/** The parameters of one robot: what they are, what is to be changed, and what came of writing it. */
import { type Item, RcpError } from "rcp-client";

import type { ParameterFile } from "./files.ts";
import type { Parameter } from "./parameter.ts";
import { type Entered, entered, same, textOf } from "./value.ts";
import { type Change, type Device, Writing } from "./writing.ts";

/** What is known of a value. */
export type Known = { value: unknown; error?: undefined } | { error: RcpError };

/** A change that has not been written. */
export type Pending = { text: string } & Entered;

/** How an editor reaches its robot. */
export interface Reach {
  device: Device;
  execute: (path: string) => Promise<unknown>;
  /** Read all of a pattern, page by page. */
  pages: (pattern: string) => AsyncIterable<Item[]>;
}

const NONE: ReadonlyMap<string, Pending> = new Map();

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
  /** Rises whenever something of the writing has changed. */
  turn = $state(0);
  readonly #reach: Reach;
  #reads = 0;

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
    for (const [path, known] of found) values.set(path, known);
    this.values = values;
  }

  /** Read all of them, as far as they are below this pattern. */
  async read(pattern: string, paths: ReadonlySet<string>): Promise<void> {
    const turn = ++this.#reads;
    this.reading = true;
    this.problem = undefined;
    try {
      for await (const items of this.#reach.pages(pattern)) {
        if (turn !== this.#reads) return;
        this.take(items.filter((one) => paths.has(one.path)).map((one) => [one.path, one.error ? { error: new RcpError(one.error) } : { value: one.body }]));
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
    const now = this.valueOf(one.path);
    const found = entered(one, text);
    const unchanged = found.fault === undefined && now !== undefined && same(found.value, now);
    this.#set([[one.path, unchanged ? undefined : { text, ...found }]]);
  }

  /** Enter several values, as of a file. */
  enterAll(all: Iterable<[one: Parameter, value: unknown]>): void {
    this.#set([...all].filter(([one]) => one.writable).map(([one, value]) => {
      const text = one.entry === "choice" ? JSON.stringify(value) : textOf(value);
      const now = this.valueOf(one.path);
      return [one.path, now !== undefined && same(value, now) ? undefined : { text, ...entered(one, text) }];
    }));
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
    this.#set([[path, undefined]]);
  }
  discard(): void {
    this.pending = NONE;
  }

  /** Write all that is pending; `parameters` in the order in which that is done. */
  async write(parameters: Parameter[]): Promise<void> {
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
    const known = writing.results.filter((one) => one.now !== undefined && one.now !== null);
    this.take(known.map((one) => [one.path, { value: one.now }]));
    // What was entered meanwhile is another change.
    const settled = writing.results.filter(({ path, outcome, value }) => (outcome === "written" || outcome === "other") && isOf(this.pending.get(path), value));
    this.#set(settled.map(({ path }) => [path, undefined]));
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
