import { RcpError } from "rcp-client";

import { checked, content, panelOf, panelsOf } from "./document.ts";
import { LayoutStore } from "./store.svelte.ts";

const NAME = "Plots";

interface Plots {
  plots: string[][];
  seconds: number;
}

/** The plots of the page Plot, kept as a layout of the user's own. */
export class PlotStore {
  readonly #layouts = new LayoutStore();
  /** The version that this page knows, to be asked for where it knows none. */
  #version: number | undefined;
  readonly usable = $derived(this.#layouts.usable);

  async save({ plots, seconds }: Plots): Promise<void> {
    const kept = content({ columns: plots.map((one) => ({ size: 1, panels: [panelOf("plot", { plots: [one], seconds })] })) });
    this.#version ??= await this.#layouts.open({ name: NAME }).then(
      (found) => found.version,
      (error: RcpError) => {
        if (error.code === "unknown_path") return 0;
        throw error;
      },
    );
    try {
      this.#version = await this.#layouts.save({ name: NAME }, this.#version, kept);
    } catch (error) {
      if ((error as RcpError).code === "precondition_failed") this.#version = undefined; // told once; pressed again, it is meant
      throw error;
    }
  }

  async load(): Promise<Plots> {
    const found = await this.#layouts.open({ name: NAME });
    this.#version = found.version;
    const all = panelsOf(checked(found.content)).filter((one) => one.kind === "plot");
    return { plots: all.flatMap((one) => one.plots ?? []), seconds: all[0]?.seconds ?? 30 };
  }
}
