/** Several parameters written together: as one where their device can do that, else one after the other. */
import { RcpError } from "rcp-client";

import { same } from "./value.ts";

const MOST = 64; // paths that the gateway takes as one
const LARGEST = 15_000; // bytes of them
/** Answers after which the device may have the value all the same. */
const UNSURE = new Set(["connection_lost", "deadline_exceeded", "device_timeout", "adapter_unavailable", "internal", "cancelled"]);

export interface Change {
  path: string;
  name: string;
  /** undefined: not known. */
  before: unknown;
  value: unknown;
  /** The group of those that can be written as one. */
  atomic: string | undefined;
}

/**
 * What became of a change: `other`: the device took it, and has another value; `kept`: its answer was lost, and it has the value of before;
 * `changed`: its answer was lost, and it has a third value; `unknown`: its answer was lost, and it could not be asked since.
 */
export type Outcome = "written" | "other" | "refused" | "kept" | "changed" | "unknown" | "unsent";

export interface Result extends Change {
  outcome: Outcome;
  /** What the device has, as far as it was read back. */
  now: unknown;
  read: boolean;
  error: RcpError | undefined;
}

export interface Step {
  changes: Change[];
  asOne: boolean;
}

/** What reaches the device. */
export interface Device {
  write: (path: string, value: unknown, approval: string | undefined) => Promise<unknown>;
  writeAll: (values: Record<string, unknown>, approval: string | undefined) => Promise<Record<string, unknown>>;
  /** Ask the device itself. */
  read: (path: string) => Promise<unknown>;
}

/** In which steps changes are written: those of one atomic group as one, as many as the gateway takes. */
export function stepsOf(changes: Change[]): Step[] {
  const steps: Step[] = [];
  const open = new Map<string, { step: Step; size: number }>();
  for (const one of changes) {
    const size = JSON.stringify([one.path, one.value]).length;
    const group = one.atomic === undefined ? undefined : open.get(one.atomic);
    if (group && group.step.changes.length < MOST && group.size + size < LARGEST) {
      group.step.changes.push(one);
      group.step.asOne = true;
      group.size += size;
      continue;
    }
    const step: Step = { changes: [one], asOne: false };
    steps.push(step);
    if (one.atomic !== undefined) open.set(one.atomic, { step, size });
  }
  return steps;
}

/** One press of Write: what is to be written, how far it has come, and what has become of it. */
export class Writing {
  readonly steps: Step[];
  readonly results: Result[];
  /** Why it has stopped before its end. */
  error: RcpError | undefined;
  done = 0;
  #next = 0;
  #stopped = false;
  #fresh = new Map<string, unknown>();
  readonly #device: Device;
  readonly #told: () => void;

  /** `told` is called whenever something has changed. */
  constructor(changes: Change[], device: Device, told: () => void) {
    this.steps = stepsOf(changes);
    this.results = this.steps.flatMap((step) => step.changes.map((one): Result => ({ ...one, outcome: "unsent", now: undefined, read: false, error: undefined })));
    this.#device = device;
    this.#told = told;
  }

  /** Whether all of it is one step, of which all or nothing comes into force. */
  get asOne(): boolean {
    return this.steps.length === 1;
  }

  /** What waits for a person's approval. */
  get waiting(): Step | undefined {
    return this.error?.code === "approval_required" && !this.#stopped ? this.steps[this.#next] : undefined;
  }

  /** What has not been sent. */
  get left(): Change[] {
    return this.steps.slice(this.#next).flatMap((step) => step.changes);
  }

  /** Send nothing more than what is under way. */
  stop(): void {
    this.#stopped = true;
  }

  get stopped(): boolean {
    return this.#stopped && this.#next < this.steps.length;
  }

  #of(step: Step): Result[] {
    const paths = new Set(step.changes.map((one) => one.path));
    return this.results.filter((one) => paths.has(one.path));
  }

  /** Write until the end or the first refusal, and read back what may have changed. */
  async run(approval?: string): Promise<void> {
    this.error = undefined;
    this.#stopped = false;
    const begun = this.#next;
    let granted = approval;
    while (this.#next < this.steps.length && !this.#stopped) {
      const step = this.steps[this.#next] as Step;
      try {
        await this.#write(step, granted);
      } catch (problem) {
        this.#fail(step, problem as RcpError);
        break;
      }
      granted = undefined;
      this.#next += 1;
      this.done += step.changes.length;
      this.#told();
    }
    await this.readBack(this.steps.slice(begun, this.#next + 1));
  }

  async #write({ changes, asOne }: Step, approval: string | undefined): Promise<void> {
    const [first] = changes as [Change];
    const taken = asOne
      ? await this.#device.writeAll(Object.fromEntries(changes.map(({ path, value }) => [path, value])), approval)
      : { [first.path]: await this.#device.write(first.path, first.value, approval) };
    for (const one of this.#of({ changes, asOne })) {
      this.#learn(one, taken[one.path]);
      one.outcome = one.now === undefined || one.now === null || same(one.now, one.value) ? "written" : "other";
      one.error = undefined;
    }
  }

  #learn(one: Result, now: unknown): void {
    one.now = now;
    if (now !== undefined && now !== null) this.#fresh.set(one.path, now);
  }

  /** What the device has told since this was last asked. */
  news(): Map<string, unknown> {
    const found = this.#fresh;
    this.#fresh = new Map();
    return found;
  }

  #fail(step: Step, error: RcpError): void {
    this.error = error;
    if (error.code === "approval_required") return;
    // Never sent: it cannot have come into force.
    const unsent = error.code === "connection_lost" && error.retryable;
    const outcome = unsent ? "unsent" : UNSURE.has(error.code) ? "unknown" : "refused";
    const faults = new Map(((error.details["faults"] ?? []) as { path: string; code: string; message: string; remedy?: string }[]).map((one) => [one.path, new RcpError(one)]));
    for (const one of this.#of(step)) {
      one.outcome = outcome;
      one.error = faults.size ? faults.get(one.path) : error;
    }
  }

  /** Whether something is left that the device has to be asked for. */
  get unread(): boolean {
    return this.results.some((one) => !one.read && one.outcome !== "unsent");
  }

  /** Ask the device what it has now of what may have changed. */
  async readBack(steps = this.steps): Promise<void> {
    for (const one of steps.flatMap((step) => this.#of(step))) {
      if (one.read || one.outcome === "unsent") continue;
      try {
        this.#learn(one, await this.#device.read(one.path));
      } catch (problem) {
        if ((problem as RcpError).code === "connection_lost") break; // the others as well
        continue;
      }
      one.read = true;
      if (one.outcome === "refused") continue;
      if (same(one.now, one.value)) one.outcome = "written";
      else if (one.outcome === "written") one.outcome = "other";
      else if (one.outcome === "unknown") one.outcome = same(one.now, one.before) ? "kept" : "changed";
      this.#told();
    }
    this.#told();
  }
}
