import { type Lease, RcpError } from "rcp-client";

import { app } from "./app.svelte.ts";

const TTL = 3; // s that control outlives its page
const AGAIN = 500; // ms between tries while a lease of our own lapses

/** Exclusive control of a part of a robot, for as long as the page has it. */
export class Control {
  readonly scope: string;
  lease = $state.raw<Lease>();
  error = $state.raw<RcpError>();
  /** Told when control is gone, by whatever way. */
  onlost: () => void = () => undefined;

  constructor(scope: string) {
    this.scope = scope;
  }

  get held(): boolean {
    return this.lease !== undefined;
  }

  /** Ask for it; with a reason, take it over from somebody of a lower priority. */
  async take(reason?: string, again = TTL * 2 + 1): Promise<void> {
    this.error = undefined;
    try {
      this.lease = await app.client.lease(this.scope, {
        ttl: TTL,
        ...(reason !== undefined && { take: true, reason }),
        lost: (notice) => {
          this.lease = undefined;
          this.onlost();
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
        await new Promise((resolve) => setTimeout(resolve, AGAIN));
        await this.take(reason, again - 1);
      }
    }
  }

  async give(): Promise<void> {
    this.onlost();
    const lease = this.lease;
    this.lease = undefined;
    await lease?.release().catch(() => undefined);
  }
}

/** The least part of the tree that holds all of these paths. */
export function common(paths: string[]): string {
  const [first = "", ...rest] = paths.map((path) => path.split("/"));
  const parts = first === "" ? [] : first;
  const end = parts.findIndex((part, at) => rest.some((other) => other[at] !== part));
  return (end < 0 ? parts : parts.slice(0, end)).join("/");
}
