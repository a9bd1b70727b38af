import { RcpError, type Resource } from "rcp-client";

import { app } from "./app.svelte.ts";
import { away } from "./away.ts";
import { past } from "./past.svelte.ts";
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
 * than `VALID`; and by the end of the lease. It moves again by a new press alone: what is held on to through the end of
 * a drive, or was held before one could begin, is let go of first.
 */
export class Drive<W> {
  readonly resource: Resource;
  error = $state.raw<RcpError>();
  /** The source whose dead-man is held. */
  source = $state<string>();
  /** Sources that are held and do not drive. */
  spent = $state.raw<string[]>([]);
  readonly #control: Control;
  readonly #value: (wish: W) => unknown;
  readonly #rest: (() => unknown) | undefined;
  readonly #held = new Set<string>();
  #wish: W | undefined;
  #timer: ReturnType<typeof setInterval> | undefined;
  #since: number | undefined; // when the write that is under way was sent
  #looked = 0; // when the last tick was
  #moving = false;

  /** `value` makes what is written of a wish; `rest` what is written at the end, where anything is. */
  constructor(resource: Resource, control: Control, value: (wish: W) => unknown, rest?: () => unknown) {
    this.resource = resource;
    this.#control = control;
    this.#value = value;
    this.#rest = rest;
  }

  /** A source holds its dead-man and wants this; it has the say if it is the only one, and was pressed just now. */
  hold(source: string, wish: W): void {
    if (this.source === source) return void (this.#wish = wish);
    if (this.#held.has(source)) return;
    this.#held.add(source);
    if (this.#held.size > 1 || !this.#control.held || app.client.state !== "open" || past.active) return this.#tell();
    this.error = undefined;
    this.#wish = wish;
    this.source = source;
    this.#looked = performance.now();
    this.#timer = setInterval(() => this.#tick(), PERIOD);
    this.#next();
  }

  /** The dead-man of a source was let go: stop at once. */
  release(source: string): void {
    this.#held.delete(source);
    if (this.source === source) this.#end();
    this.#tell();
  }

  /** Stop at once, for what is no hand's doing: who holds on has to let go before anything moves again. */
  cut(error?: RcpError): void {
    if (error) this.error = error;
    this.#end();
    this.#tell();
  }

  /** Nobody is seen to hold a source that may be held: it has to be let go of. */
  spend(source: string): void {
    this.#held.add(source);
    if (this.source === source) this.#end();
    this.#tell();
  }

  #end(): void {
    this.source = undefined;
    clearInterval(this.#timer);
    if (this.#moving && this.#rest) void this.#send(this.#rest(), true);
    this.#moving = false;
  }

  #tell(): void {
    const spent = [...this.#held].filter((one) => one !== this.source);
    if (spent.join() !== this.spent.join()) this.spent = spent;
  }

  #tick(): void {
    const now = performance.now();
    const late = now - this.#looked;
    this.#looked = now;
    if (app.client.state !== "open" || !this.#control.held || away()) return this.cut();
    // The gateway has stopped the robot meanwhile, and whether a hand is still there is not known.
    if (late > SLOW) return this.cut(slow("held_up", "this page was unresponsive for a moment", "Drive again when the page responds normally."));
    this.#next();
  }

  /** Write what is wanted; one at a time, so that a slow way is not filled up. */
  #next(): void {
    if (this.#since !== undefined) {
      if (performance.now() - this.#since > SLOW) this.cut(slow("link_slow", "the gateway responds too slowly", "Drive again when the latency is low."));
      return;
    }
    this.#moving = true;
    void this.#send(this.#value(this.#wish as W), false);
  }

  async #send(value: unknown, last: boolean): Promise<void> {
    if (!last) this.#since = performance.now();
    try {
      const validFor = this.resource.safe === undefined ? {} : { validFor: VALID };
      await app.client.write(this.resource.path, value, validFor);
    } catch (problem) {
      if (!last) this.cut(problem as RcpError);
      else if (this.#control.held) this.error ??= problem as RcpError; // without control it is the gateway that stops it
    } finally {
      if (!last) this.#since = undefined;
    }
  }
}

const slow = (code: string, message: string, remedy: string): RcpError => new RcpError({ code, message, remedy });

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
