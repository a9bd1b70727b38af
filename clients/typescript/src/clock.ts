const KEPT = 16; // round trips: about half a minute of pings

/**
 * The gateway's clock, seen from here.
 *
 * The round trip that took least time bounds the offset best, as the delay can have been on one way only.
 */
export class Clock {
  /** Seconds to add to this machine's time to have the gateway's. */
  offset = 0;
  /** Seconds of the last round trip; undefined before the first. */
  latency: number | undefined;
  #trips: { took: number; offset: number }[] = [];

  /** Take a round trip: `sent` and `came` in ms of this machine, `told` by the gateway in between. */
  measure(sent: number, came: number, told: string): void {
    const took = (came - sent) / 1000;
    const offset = (Date.parse(told) - (sent + came) / 2) / 1000;
    if (!Number.isFinite(offset)) return;
    this.latency = took;
    this.#trips.push({ took, offset });
    if (this.#trips.length > KEPT) this.#trips.shift();
    this.offset = this.#trips.reduce((best, trip) => (trip.took <= best.took ? trip : best)).offset;
  }

  /** Forget what was measured: another machine may answer now. */
  reset(): void {
    this.#trips = [];
    this.latency = undefined;
  }

  /** The gateway's time in ms since the epoch. */
  now(): number {
    return Date.now() + this.offset * 1000;
  }

  /** Seconds since a timestamp of the gateway, never below 0. */
  age(timestamp: string): number {
    return Math.max(0, (this.now() - Date.parse(timestamp)) / 1000);
  }
}

/** A moment by both clocks of this machine: one may be set anew, the other stands while the machine sleeps. */
export class Moment {
  readonly wall = Date.now();
  readonly #steady = performance.now();

  /** ms since then, by the clock that tells of more. */
  get passed(): number {
    return Math.max(Date.now() - this.wall, performance.now() - this.#steady);
  }
}
