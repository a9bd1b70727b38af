import { ask } from "../api.ts";
import { app } from "../app.svelte.ts";

/** Something that a plugin's panel reads or writes, by the name that it has there. */
export interface Port {
  name: string;
  description: string;
}

/** A panel that a plugin of the gateway offers. */
export interface PluginPanel {
  name: string;
  title: string;
  description: string;
  reads: Port[];
  writes: Port[];
}

/** The panels of plugins, asked for once for each login. */
class Plugins {
  all = $state.raw<PluginPanel[]>([]);
  known = $state(false);
  problem = $state("");
  #epoch: number | undefined;

  look(): void {
    if (this.#epoch === app.epoch && !this.problem) return;
    this.#epoch = app.epoch;
    this.known = false;
    this.problem = "";
    ask("panels").then(
      (found) => {
        this.all = (found as { panels: PluginPanel[] }).panels;
        this.known = true;
      },
      (error: Error) => (this.problem = error.message),
    );
  }
}

const found = new Plugins();

/** The panels of plugins, to be called in a component. */
export function plugins(): Plugins {
  $effect(() => {
    void app.epoch;
    if (app.known) found.look();
  });
  return found;
}
