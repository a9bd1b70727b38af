const KEPT = 16; // round trips: about half a minute of pings
const SET = 250; // ms by which the clocks of this machine differ otherwise than before: one was set, or stood in its sleep

/** This machine's time in ms since the epoch, which nobody sets while the page or program runs. */
export function steady(): number {
  return performance.timeOrigin + performance.now();
}

/**
 * The gateway's clock, seen from here.
 *
 * The round trip that took least time bounds the offset best, as the delay can have been on one way only.
 */
export class Clock {
  /** Seconds of the last round trip; undefined before the first. */
  latency: number | undefined;
  #trips: { took: number; offset: number }[] = [];
  /** ms that `Date.now` was ahead of `steady` at the last round trip. */
  #apart = 0;
  /** Seconds to add to `steady` to have the gateway's time. */
  #ahead = 0;

  /** Seconds to add to this machine's time to have the gateway's. */
  get offset(): number {
    return (this.now() - Date.now()) / 1000;
  }

  /** Take a round trip: `sent` and `came` by `steady`, `told` by the gateway in between. */
  measure(sent: number, came: number, told: string): void {
    const took = (came - sent) / 1000;
    const offset = (Date.parse(told) - (sent + came) / 2) / 1000;
    if (!Number.isFinite(offset)) return;
    if (!this.known) this.#trips = []; // they may be of before a sleep
    this.#apart = Date.now() - steady();
    this.latency = took;
    this.#trips.push({ took, offset });
    if (this.#trips.length > KEPT) this.#trips.shift();
    this.#ahead = this.#trips.reduce((best, trip) => (trip.took <= best.took ? trip : best)).offset;
  }

  /** Forget what was measured: another machine may answer now. */
  reset(): void {
    this.#trips = [];
    this.latency = undefined;
  }

  /** Whether the time is as it was measured: not after this machine's clock was set or stood in its sleep, until a round trip. */
  get known(): boolean {
    return Math.abs(Date.now() - steady() - this.#apart) <= SET;
  }

  /** The gateway's time in ms since the epoch; where it is not `known`, by the clock of this machine that tells of more. */
  now(): number {
    const asleep = this.known ? 0 : Math.max(0, Date.now() - steady() - this.#apart);
    return steady() + asleep + this.#ahead * 1000;
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

  /** By `steady`, ms since the epoch. */
  get steady(): number {
    return performance.timeOrigin + this.#steady;
  }

  /** Whether a clock was set or stood since then. */
  get torn(): boolean {
    return Math.abs(Date.now() - this.wall - (performance.now() - this.#steady)) > SET;
  }

  /** ms since then, by the clock that tells of more. */
  get passed(): number {
    return Math.max(Date.now() - this.wall, performance.now() - this.#steady);
  }
}
