import { app } from "./app.svelte.ts";
import { past } from "./past.svelte.ts";

/** A clock that ticks four times a second: ages are shown by it. */
class Ticking {
  now = $state(Date.now());
  constructor() {
    setInterval(() => (this.now = Date.now()), 250);
  }
}

const ticking = new Ticking();

const AHEAD = 2; // s
const MOST = 2000;
/** When timestamps were first met that clocks ahead of the gateway's had told, in its ms. */
const ahead = new Map<string, number>();

/** Seconds since a timestamp of the gateway or a robot; it follows the time. One in the future is as old as it is known here. */
export function age(timestamp: string | undefined): number | undefined {
  if (!timestamp) return undefined;
  const now = ticking.now + app.client.clock.offset * 1000;
  const seconds = (now - Date.parse(timestamp)) / 1000;
  if (Number.isNaN(seconds)) return undefined;
  if (seconds < -AHEAD && !ahead.has(timestamp)) {
    if (ahead.size >= MOST) ahead.delete(ahead.keys().next().value as string);
    ahead.set(timestamp, now);
  }
  const met = ahead.get(timestamp);
  return Math.max(0, seconds, met === undefined ? 0 : (now - met) / 1000);
}

/** Seconds that a value of a robot is old at the moment that the page shows: the present, or one in the past. */
export function ageShown(timestamp: string | undefined): number | undefined {
  if (!past.shown) return age(timestamp);
  const seconds = timestamp === undefined ? NaN : ((past.at ?? 0) - Date.parse(timestamp)) / 1000;
  return Number.isNaN(seconds) ? undefined : Math.max(0, seconds);
}

/** Whether a value should have come again by now, by the deadline (s) of its path; it follows the time. */
export function overdue(timestamp: string | undefined, deadline: number | undefined): boolean {
  const seconds = ageShown(timestamp);
  return seconds !== undefined && deadline !== undefined && seconds > deadline + 0.5;
}

/** Seconds until a timestamp of the gateway, down to 0; it follows the time. */
export function left(timestamp: string): number {
  const now = ticking.now + app.client.clock.offset * 1000;
  return Math.max(0, (Date.parse(timestamp) - now) / 1000);
}
