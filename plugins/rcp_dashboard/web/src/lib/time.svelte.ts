import { app } from "./app.svelte.ts";

/** A clock that ticks four times a second: ages are shown by it. */
class Ticking {
  now = $state(Date.now());
  constructor() {
    setInterval(() => (this.now = Date.now()), 250);
  }
}

const ticking = new Ticking();

/** Seconds since a timestamp of the gateway; it follows the time. */
export function age(timestamp: string | undefined): number | undefined {
  if (!timestamp) return undefined;
  const now = ticking.now + app.client.clock.offset * 1000;
  return Math.max(0, (now - Date.parse(timestamp)) / 1000);
}

/** Whether a value should have come again by now, by the deadline (s) of its path; it follows the time. */
export function overdue(timestamp: string | undefined, deadline: number | undefined): boolean {
  const seconds = age(timestamp);
  return seconds !== undefined && deadline !== undefined && seconds > deadline + 0.5;
}

/** Seconds until a timestamp of the gateway, down to 0; it follows the time. */
export function left(timestamp: string): number {
  const now = ticking.now + app.client.clock.offset * 1000;
  return Math.max(0, (Date.parse(timestamp) - now) / 1000);
}
