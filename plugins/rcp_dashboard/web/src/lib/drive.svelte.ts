import { type Lease, RcpError, type Resource } from "rcp-client";

import { app } from "./app.svelte.ts";
import { steering, type Steering } from "./twist.ts";

const PERIOD = 80; // ms between writes while a dead-man is held
const FIRST = 1; // m/s that full deflection means at most, until somebody asks for more
const VALID = 0.4; // s that a write stands: what is lost on the way stops the robot this soon
const TTL = 3; // s that control outlives its page
const SLOW = 1000; // ms of one write beyond which driving ends

/** What a source wants, each −1…1: forward, and turning to the left. */
export interface Wish {
  forward: number;
  turn: number;
}

/**
 * Drives one actuator while somebody holds a dead-man, under a lease.
 *
 * The robot is stopped three times over: here, when the dead-man is let go; by the gateway, as no write stands longer
 * than `VALID`; and by the end of the lease.
 */
export class Drive {
  readonly resource: Resource;
  readonly steering: Steering;
  lease = $state.raw<Lease>();
  error = $state.raw<RcpError>();
  /** The source whose dead-man is held. */
  source = $state<string>();
  sent = $state.raw({ forward: 0, turn: 0 });
  /** The part of what the actuator takes that full deflection means. */
  limit = $state(0);
  #wish: Wish = { forward: 0, turn: 0 };
  #timer: ReturnType<typeof setInterval> | undefined;
  #since: number | undefined; // when the write that is under way was sent
  #moving = false;

  constructor(resource: Resource, how: Steering) {
    this.resource = resource;
    this.steering = how;
    this.limit = Math.max(0.05, Math.min(0.3, FIRST / how.forward));
  }

  static of(resource: Resource): Drive | undefined {
    const how = steering(resource);
    return how && new Drive(resource, how);
  }

  get held(): boolean {
    return this.lease !== undefined;
  }

  async take(over = false, again = TTL * 2 + 1): Promise<void> {
    this.error = undefined;
    try {
      this.lease = await app.client.lease(this.resource.path, {
        ttl: TTL,
        ...(over && { take: true, reason: "taken over on the dashboard" }),
        lost: (notice) => {
          this.lease = undefined;
          this.release();
          const message = notice ? `control was lost: ${notice["reason"] ?? notice.message ?? ""} ${notice["by"] ? `(${notice["by"]})` : ""}` : "control was lost with the session";
          this.error = new RcpError({ code: "lease_lost", message, remedy: "Take control again when it is yours to take." });
        },
      });
    } catch (problem) {
      const error = problem as RcpError;
      // A page that was closed or loaded anew has left its lease to lapse: that is waited for.
      const own = error.code === "lease_held" && error.details["holder"] === app.hello?.principal;
      if (!own || again <= 0) this.error = error;
      else {
        await new Promise((resolve) => setTimeout(resolve, 500));
        await this.take(over, again - 1);
      }
    }
  }

  async give(): Promise<void> {
    this.release();
    const lease = this.lease;
    this.lease = undefined;
    await lease?.release().catch(() => undefined);
  }

  /** A source holds its dead-man and wants this; the first to hold it has the say. */
  hold(source: string, wish: Wish): void {
    if (!this.held || (this.source !== undefined && this.source !== source)) return;
    this.#wish = wish;
    if (this.source !== undefined) return;
    this.error = undefined;
    this.source = source;
    this.#timer = setInterval(() => this.#tick(), PERIOD);
    this.#tick();
  }

  /** The dead-man was let go: stop at once. */
  release(source?: string): void {
    if (this.source === undefined || (source !== undefined && source !== this.source)) return;
    this.source = undefined;
    clearInterval(this.#timer);
    this.#wish = { forward: 0, turn: 0 };
    if (this.#moving) void this.#write(0, 0);
    this.#moving = false;
  }

  #tick(): void {
    if (app.client.state !== "open") return this.release();
    if (this.#since !== undefined) {
      if (performance.now() - this.#since < SLOW) return; // one at a time: a slow way is not filled up
      this.release();
      this.error = new RcpError({ code: "link_slow", message: "the gateway takes too long to answer", remedy: "Drive again when the latency is low." });
      return;
    }
    const { forward, turn } = this.#wish;
    void this.#write(forward * this.steering.forward * this.limit, turn * this.steering.turn * this.limit);
    this.#moving = true;
  }

  async #write(forward: number, turn: number): Promise<void> {
    this.sent = { forward, turn };
    const stop = forward === 0 && turn === 0;
    if (!stop) this.#since = performance.now();
    try {
      const validFor = this.resource.safe === undefined ? {} : { validFor: VALID };
      await app.client.write(this.resource.path, this.steering.value(forward, turn), validFor);
    } catch (problem) {
      this.error = problem as RcpError;
      if (!stop) this.release();
    } finally {
      if (!stop) this.#since = undefined;
    }
  }
}
