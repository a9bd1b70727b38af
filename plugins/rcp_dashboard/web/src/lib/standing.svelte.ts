import type { Update } from "rcp-client";

import { app } from "./app.svelte.ts";
import { Gathered } from "./gathered.ts";
import { alarming } from "./robots.ts";

const MOST = 5000; // alarms that are known at once

/** The alarms that stand, of all robots: events that say `active`, until they say otherwise. */
export class StandingAlarms {
  #standing = $state.raw<ReadonlyMap<string, string>>(new Map());
  /** The robots that have one. */
  readonly robots = $derived(new Set(this.#standing.values()));
  readonly #paths = $derived(JSON.stringify(app.resources.filter((one) => alarming(one) && one.operations.includes("subscribe")).map((one) => one.path)));

  /** Follow them, to be called in a component. */
  start(): void {
    $effect(() => {
      const paths = JSON.parse(this.#paths) as string[];
      if (paths.length === 0) return;
      const told = new Gathered<Update>(MOST, (all) => this.#take(all));
      // One subscription for all of them: of hundreds of robots they would be more than a session may have.
      const all = app.client.subscribe(paths, { history: 20, qos: { depth: 64 } }, { update: (update) => told.add(`${update.path} ${update.body?.fault ?? ""}`, update) });
      return () => {
        void all.close();
        told.stop();
        this.#standing = new Map();
      };
    });
  }

  #take(all: Map<string, Update>): void {
    const made = new Map([...this.#standing].filter(([key]) => !all.has(key)));
    for (const [key, update] of all) if (update.body?.active === true) made.set(key, app.byPath.get(update.path)?.backend ?? "");
    this.#standing = new Map([...made].slice(-MOST));
  }
}
