import { RcpError, type Resource } from "rcp-client";

import { app } from "./app.svelte.ts";
import type { Control } from "./control.svelte.ts";
import { type Speeds, type Steering, STILL } from "./twist.ts";

const PERIOD = 80; // ms between writes while a dead-man is held
const FIRST = 1; // m/s that full deflection means at most, until somebody asks for more
const VALID = 0.4; // s that a write stands: what is lost on the way stops the robot this soon
const SLOW = 1000; // ms of one write beyond which driving ends

/**
 * Commands one actuator while somebody holds a dead-man, under a lease.
 *
 * The robot is stopped three times over: here, when the dead-man is let go; by the gateway, as no write stands longer
 * than `VALID`; and by the end of the lease.
 */
export class Drive<W> {
  readonly resource: Resource;
  error = $state.raw<RcpError>();
  /** The source whose dead-man is held. */
  source = $state<string>();
  readonly #control: Control;
  readonly #value: (wish: W) => unknown;
  readonly #rest: (() => unknown) | undefined;
  #wish: W | undefined;
  #timer: ReturnType<typeof setInterval> | undefined;
  #since: number | undefined; // when the write that is under way was sent
  #moving = false;

  /** `value` makes what is written of a wish; `rest` what is written at the end, where anything is. */
  constructor(resource: Resource, control: Control, value: (wish: W) => unknown, rest?: () => unknown) {
    this.resource = resource;
    this.#control = control;
    this.#value = value;
    this.#rest = rest;
  }

  /** A source holds its dead-man and wants this; the first to hold it has the say. */
  hold(source: string, wish: W): void {
    if (!this.#control.held || (this.source !== undefined && this.source !== source)) return;
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
    if (this.#moving && this.#rest) void this.#write(this.#rest(), true);
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
    void this.#write(this.#value(this.#wish as W), false);
    this.#moving = true;
  }

  async #write(value: unknown, last: boolean): Promise<void> {
    if (!last) this.#since = performance.now();
    try {
      const validFor = this.resource.safe === undefined ? {} : { validFor: VALID };
      await app.client.write(this.resource.path, value, validFor);
    } catch (problem) {
      this.error = problem as RcpError;
      if (!last) this.release();
    } finally {
      if (!last) this.#since = undefined;
    }
  }
}

/** Drives what takes speeds; a wish is −1…1 along each axis. */
export class Steer {
  readonly drive: Drive<Speeds>;
  readonly steering: Steering;
  sent = $state.raw<Speeds>(STILL);
  /** What full deflection means: a part of what the actuator takes, along the axes and about the vertical. */
  speed = $state(0);
  turning = $state(0.3);

  constructor(resource: Resource, steering: Steering, control: Control) {
    this.steering = steering;
    this.speed = Math.max(0.05, Math.min(0.3, FIRST / steering.most.forward));
    const value = (wish: Speeds): unknown => {
      const { most } = steering;
      const { speed, turning } = this;
      this.sent = { forward: wish.forward * most.forward * speed, side: wish.side * most.side * speed, up: wish.up * most.up * speed, turn: wish.turn * most.turn * turning };
      return steering.value(this.sent);
    };
    this.drive = new Drive(resource, control, value, () => value(STILL));
  }
}
