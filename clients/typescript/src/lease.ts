import type { RcpError } from "./errors.ts";
import type { LeaseState, Notice } from "./wire.ts";

const GONE = new Set(["lease_lost", "lease_required"]); // what a renewal is answered when there is no lease

/** Exclusive control of a part of the tree, renewed until it is released or lost. */
export class Lease {
  state: LeaseState;
  /** Set when somebody took it over, it lapsed, or an e-stop ended it. */
  lost: Notice | undefined;
  readonly #ask: (input: Record<string, unknown>) => Promise<LeaseState>;
  readonly #told: { ended: (lease: Lease) => void; lost: (notice: Notice | undefined) => void };
  #timer: ReturnType<typeof setTimeout> | undefined;
  readonly #ttl: number;

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
    this.#timer = setTimeout(async () => {
      try {
        this.state = await this.#ask({ do: "renew", lease: this.state.lease, ttl: this.#ttl });
      } catch (problem) {
        // A cut may pass before the lease lapses. A loss is told by its notice; what this session gave away is not.
        if (GONE.has((problem as RcpError).code)) return this.lose(undefined);
      }
      if (this.held) this.#schedule();
    }, (this.#ttl * 1000) / 3);
  }

  #stop(): void {
    clearTimeout(this.#timer);
    this.#timer = undefined;
    this.#told.ended(this);
  }

  /** Give it back. */
  async release(): Promise<void> {
    if (!this.held) return;
    this.#stop();
    await this.#ask({ do: "release", lease: this.state.lease });
  }

  /**
   * Hand it over, with the commands that run under it, to a principal or to the first eight characters of a session's id;
   * returns its state there. It is not held here any more, which `lost` is not called for. The heir goes on with
   * `lease(scope)`. If it is refused, it is held and renewed as before.
   */
  async handOver(to: string): Promise<LeaseState> {
    clearTimeout(this.#timer); // a renewal after it would be refused, as if it had been lost
    try {
      this.state = await this.#ask({ do: "hand_over", lease: this.state.lease, to });
    } catch (problem) {
      if (this.held) this.#schedule();
      throw problem;
    }
    this.#stop();
    return this.state;
  }

  /** Note that it is gone. */
  lose(notice: Notice | undefined): void {
    if (!this.held) return;
    this.#stop();
    this.lost = notice;
    this.#told.lost(notice);
  }
}
