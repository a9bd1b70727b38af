import type { RcpError } from "rcp-client";

/** Asking the gateway whether it would take something; an answer that comes when something else is shown is dropped. */
export class Checking {
  words = $state("");
  refused = $state.raw<RcpError>();
  readonly #subject: () => readonly unknown[];

  /** Take what tells what is shown, by identity. */
  constructor(subject: () => readonly unknown[]) {
    this.#subject = subject;
  }

  async ask(run: () => Promise<unknown>, accepted: string): Promise<void> {
    const meant = this.#subject();
    const still = (): boolean => this.#subject().every((one, place) => one === meant[place]);
    this.refused = undefined;
    this.words = "Checking…";
    try {
      await run();
      if (still()) this.words = accepted;
    } catch (error) {
      if (!still()) return;
      this.words = "";
      this.refused = error as RcpError;
    }
  }

  /** Tell nothing more of what was asked. */
  clear(): void {
    this.words = "";
    this.refused = undefined;
  }
}
