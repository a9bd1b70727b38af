import { type Lease, type Notice, RcpError } from "rcp-client";

import { app } from "./app.svelte.ts";

const TTL = 3; // s that control outlives its page
const AGAIN = 500; // ms between tries while a lease of our own lapses

/** What is asked about leases, one after the other: two that overlap are one and the same to the gateway. */
let asked: Promise<unknown> = Promise.resolve();

/** Exclusive control of a part of a robot, for as long as the page has it. */
export class Control {
  readonly scope: string;
  lease = $state.raw<Lease>();
  error = $state.raw<RcpError>();
  /** Whether it is being asked for. */
  asking = $state(false);
  readonly #lost = new Set<() => void>();
  #turn = 0; // of asking for it and giving it back: what is answered in an earlier one is wanted no more

  constructor(scope: string) {
    this.scope = scope;
  }

  get held(): boolean {
    return this.lease !== undefined;
  }

  /** Call back when control is gone, by whatever way, until the returned function is called. */
  onLost(told: () => void): () => void {
    this.#lost.add(told);
    return () => this.#lost.delete(told);
  }

  #tellLost(): void {
    for (const told of this.#lost) told();
  }

  /** Ask for it; with a reason, take it over from somebody of a lower priority. */
  async take(reason?: string): Promise<void> {
    if (this.asking || this.held) return;
    const turn = ++this.#turn;
    this.asking = true;
    this.error = undefined;
    asked = asked.then(() => this.#ask(turn, reason));
    await asked;
    if (turn === this.#turn) this.asking = false;
  }

  async #ask(turn: number, reason: string | undefined): Promise<void> {
    for (let tries = TTL * 2 + 1; turn === this.#turn; tries--) {
      try {
        const lease: Lease = await app.client.lease(this.scope, {
          ttl: TTL,
          ...(reason !== undefined && { take: true, reason }),
          lost: (notice) => {
            if (lease === this.lease) this.#lose(notice);
          },
        });
        if (turn === this.#turn) this.lease = lease;
        else await lease.release().catch(() => undefined);
        return;
      } catch (problem) {
        const error = problem as RcpError;
        // A page that was closed or loaded anew has left its lease to lapse: that is waited for.
        const own = error.code === "lease_held" && error.details["holder"] === app.hello?.principal;
        if (!own || tries <= 0) {
          if (turn === this.#turn) this.error = error;
          return;
        }
        await new Promise((resolve) => setTimeout(resolve, AGAIN));
      }
    }
  }

  #lose(notice: Notice | undefined): void {
    this.lease = undefined;
    this.#tellLost();
    const message = notice ? `control lost: ${notice["reason"] ?? notice.message ?? ""} ${notice["by"] ? `(${notice["by"]})` : ""}` : "control lost: the session ended";
    this.error = new RcpError({ code: "lease_lost", message, remedy: "Press Take control to get it back." });
  }

  async give(): Promise<void> {
    this.#turn += 1;
    this.asking = false;
    this.#tellLost();
    const lease = this.lease;
    this.lease = undefined;
    await lease?.release().catch(() => undefined);
  }
}

const inUse = new Map<string, { control: Control; users: number }>();
const keyOf = (scope: string): string => `${app.epoch} ${scope}`;

/** The control of a scope, which all parts of a page share that name the same one. */
export function controlOf(scope: string): Control {
  const key = keyOf(scope);
  let found = inUse.get(key);
  if (!found) inUse.set(key, (found = { control: new Control(scope), users: 0 }));
  return found.control;
}

/** Use it until the returned function is called; the last user gives it back. */
export function use(control: Control): () => void {
  const [key, shared] = [...inUse].find(([, one]) => one.control === control) ?? [keyOf(control.scope), { control, users: 0 }];
  inUse.set(key, shared);
  shared.users += 1;
  return () => {
    shared.users -= 1;
    if (shared.users > 0) return;
    if (inUse.get(key) === shared) inUse.delete(key);
    void control.give();
  };
}

/** The least part of the tree that holds all of these paths. */
export function common(paths: string[]): string {
  const [first = "", ...rest] = paths.map((path) => path.split("/"));
  const parts = first === "" ? [] : first;
  const end = parts.findIndex((part, at) => rest.some((other) => other[at] !== part));
  return (end < 0 ? parts : parts.slice(0, end)).join("/");
}
