import type { RcpError } from "./errors.ts";
import type { LeaseState, Notice } from "./wire.ts";

const GONE = new Set(["lease_lost", "lease_required"]); // what is answered when there is no lease

/** Exclusive control of a part of the tree, renewed until it is released or lost. */
export class Lease {
  state: LeaseState;
  /** Set when somebody took it over, it lapsed, or an e-stop ended it. */
  lost: Notice | undefined;
  readonly #ask: (input: Record<string, unknown>) => Promise<LeaseState>;
  readonly #told: { ended: (lease: Lease) => void; lost: (notice: Notice | undefined) => void };
  readonly #ttl: number;
  #timer: ReturnType<typeof setTimeout> | undefined;
  #renewing = false;
  /** How many requests to hand it over have no answer yet. */
  #handing = 0;
  /** Whether it is to be released, and the gateway has not said that it is. */
  #owed = false;

  constructor(
    state: LeaseState,
    ttl: number,
    ask: (input: Record<string, unknown>) => Promise<LeaseState>,
    told: { ended: (lease: Lease) => void; lost: (notice: Notice | undefined) => void },
  ) {
    this.state = state;
    this.#ttl = ttl;
    this.#ask = ask;
    this.#told = told;
    this.#schedule();
  }

  /** Whether it is held here: neither released nor handed over nor lost. */
  get held(): boolean {
    return this.#timer !== undefined;
  }

  #schedule(): void {
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => {
      this.#schedule();
      void this.#renew();
    }, (this.#ttl * 1000) / 3);
  }

  async #renew(): Promise<void> {
    if (this.#renewing) return;
    this.#renewing = true;
    try {
      const state = await this.#ask({ do: "renew", lease: this.state.lease, ttl: this.#ttl });
      if (this.held) this.state = state;
    } catch (problem) {
      // A cut may pass before the lease lapses. A loss is told by its notice; what this session gave away is not. While it
      // is handed over, it may be the heir's already.
      if (this.#handing === 0 && isGone(problem)) this.lose(undefined);
    } finally {
      this.#renewing = false;
    }
  }

  #stop(): void {
    clearTimeout(this.#timer);
    this.#timer = undefined;
    this.#told.ended(this);
  }

  /** Give it back. It is not held here any more, whatever comes of it; if this rejects, call it again. */
  async release(): Promise<void> {
    if (this.held) {
      this.#owed = true;
      this.#stop();
    }
    if (!this.#owed) return;
    try {
      await this.#ask({ do: "release", lease: this.state.lease });
    } catch (problem) {
      if (!isGone(problem)) throw problem; // a release whose answer was lost, or the lease has lapsed
    }
    this.#owed = false;
  }

  /**
   * Hand it over, with the commands that run under it, to a principal or to the first eight characters of a session's id;
   * returns its state there. It is not held here any more, which `lost` is not called for. The heir goes on with
   * `lease(scope)`. If it is refused, it is held as before. It is renewed until the answer comes.
   */
  async handOver(to: string): Promise<LeaseState> {
    this.#handing += 1;
    try {
      this.state = await this.#ask({ do: "hand_over", lease: this.state.lease, to });
      this.#owed = false;
      this.#stop();
      return this.state;
    } finally {
      this.#handing -= 1;
    }
  }

  /** Note that it is gone. */
  lose(notice: Notice | undefined): void {
    if (!this.held) return;
    this.#stop();
    this.lost = notice;
    this.#told.lost(notice);
  }
}

function isGone(problem: unknown): boolean {
  return GONE.has((problem as RcpError).code);
}
