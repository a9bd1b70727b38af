import type { RcpError } from "./errors.ts";
import type { LeaseState, Notice } from "./wire.ts";

const GONE = new Set(["lease_lost", "lease_required"]); // what a renewal is answered when there is no lease

/** Exclusive control of a part of the tree, renewed until it is released or lost. */
export class Lease {
  state: LeaseState;
  /** Set when somebody took it over, it lapsed, or an e-stop ended it. */
  lost: Notice | undefined;
  readonly #renew: (lease: string) => Promise<LeaseState>;
  readonly #release: (lease: Lease) => Promise<void>;
  readonly #told: (notice: Notice | undefined) => void;
  #timer: ReturnType<typeof setTimeout> | undefined;
  readonly #every: number;

  constructor(
    state: LeaseState,
    ttl: number,
    renew: (lease: string) => Promise<LeaseState>,
    release: (lease: Lease) => Promise<void>,
    lost: (notice: Notice | undefined) => void,
  ) {
    this.state = state;
    this.#renew = renew;
    this.#release = release;
    this.#told = lost;
    this.#every = (ttl * 1000) / 3;
    this.#schedule();
  }

  #schedule(): void {
    this.#timer = setTimeout(async () => {
      try {
        this.state = await this.#renew(this.state.lease);
      } catch (problem) {
        // A cut may pass before the lease lapses. A loss is told by its notice; what this session gave away is not.
        if (GONE.has((problem as RcpError).code)) return this.lose(undefined);
      }
      if (this.#timer !== undefined) this.#schedule();
    }, this.#every);
  }

  #stop(): void {
    clearTimeout(this.#timer);
    this.#timer = undefined;
  }

  /** Give it back. */
  async release(): Promise<void> {
    this.#stop();
    if (this.lost === undefined) await this.#release(this);
  }

  /** Note that it is gone. */
  lose(notice: Notice | undefined): void {
    if (this.#timer === undefined) return; // released, or lost already
    this.#stop();
    this.lost = notice;
    this.#told(notice);
  }
}
