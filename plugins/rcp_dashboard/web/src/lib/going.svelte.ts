import type { Command, RcpError } from "rcp-client";

import { app } from "./app.svelte.ts";

/** One errand at a time that a page has sent a robot on, with how it stands. */
export class Going {
  path = $state("");
  status = $state("");
  progress = $state<number>();
  done = $state(false);
  error = $state.raw<RcpError>();
  #command: Command | undefined;

  /** Send it, and return when it has ended, well or not. */
  async go(path: string, input: unknown): Promise<void> {
    const command = app.client.execute(path, input);
    this.#command = command;
    this.error = undefined;
    this.path = path;
    const told = (): void => {
      if (this.#command !== command) return;
      this.status = command.status;
      this.progress = command.progress;
      this.done = command.done;
    };
    told();
    command.changed(told);
    try {
      await command.result;
    } catch (error) {
      if (this.#command === command) this.error = error as RcpError;
    }
    told();
  }

  cancel(): void {
    this.#command?.cancel().catch((told) => (this.error = told));
  }

  /** Tell of it no more. */
  close(): void {
    this.#command = this.error = undefined;
    this.path = "";
  }
}
