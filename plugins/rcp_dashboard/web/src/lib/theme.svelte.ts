import { keep, kept } from "./kept.ts";

const KEY = "rcp.theme";

/** Dark or light: as the person chose, else as the system is. */
class Theme {
  chosen = $state(kept(KEY) ?? "");
  readonly #system = matchMedia("(prefers-color-scheme: light)");
  name = $state<"dark" | "light">("dark");

  constructor() {
    this.#system.addEventListener("change", () => this.apply());
  }

  apply(): void {
    const wanted = this.chosen || (this.#system.matches ? "light" : "dark");
    this.name = wanted === "light" ? "light" : "dark";
    document.documentElement.dataset["theme"] = this.name;
  }

  toggle(): void {
    this.chosen = this.name === "dark" ? "light" : "dark";
    keep(KEY, this.chosen, "computer");
    this.apply();
  }
}

export const theme = new Theme();
