import { type Command, RcpError } from "rcp-client";

import { app } from "./app.svelte.ts";
import { past } from "./past.svelte.ts";

interface Options {
  approval?: string | undefined;
  /** What follows the completion, also of what had to be approved and was sent again. */
  completed?: (() => Promise<void> | void) | undefined;
  /** What sends it again, where more has to be done than that. */
  resend?: ((approval: string) => Promise<void>) | undefined;
}

/** One errand at a time that a page has sent a robot on, with how it stands. */
export class Going {
  path = $state("");
  input = $state.raw<unknown>();
  status = $state("");
  progress = $state<number>();
  done = $state(false);
  error = $state.raw<RcpError>();
  /** What lets it pass once a person has approved it, where one has to. */
  approval = $derived(this.error?.code === "approval_required" ? (this.error.details["approval"] as string) : undefined);
  /** Whether it is under way, or may be as soon as it is approved. */
  stands = $derived(this.path !== "" && (!this.done || this.approval !== undefined));
  #command: Command | undefined;
  #options: Options = {};

  /** Send it, and return when it has ended, well or not. */
  async go(path: string, input: unknown, options: Options = {}): Promise<void> {
    const { approval, completed } = options;
    if (past.active) return this.refuse("this page shows the past", "Press Back to live, then send it again.");
    const command = app.client.execute(path, input, { ...(approval && { approval }) });
    this.#command = command;
    this.error = undefined;
    this.path = path;
    this.input = input;
    this.#options = options;
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
      return told();
    }
    told();
    await completed?.();
  }

  /** Send what a person has approved: the same as before. */
  async again(): Promise<void> {
    const [approval, options] = [this.approval, this.#options];
    if (approval && options.resend) await options.resend(approval);
    else await this.go(this.path, this.input, { ...options, approval });
  }

  /** Tell why nothing was sent. */
  refuse(message: string, remedy: string): void {
    this.close();
    this.error = new RcpError({ code: "not_sent", message, remedy });
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
