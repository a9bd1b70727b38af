import { RcpError } from "./errors.ts";
import { FINAL, type Reply, type WireError } from "./wire.ts";

/** Feedback while a command runs. */
export interface Feedback<F> {
  body: F;
  /** The part done, 0…1, where the robot reports it. */
  progress: number | undefined;
}

/**
 * One `execute`, from its acceptance to its final status.
 *
 * `accepted` and `result` reject with the gateway's refusal. Iterating yields the feedback, and ends with the command.
 */
export class Command<O = any, F = any> {
  /** The gateway's id, once accepted. */
  id: string | undefined;
  readonly path: string;
  status: Reply["status"] | "sent" = "sent";
  progress: number | undefined;
  feedback: F | undefined;
  readonly accepted: Promise<string>;
  readonly result: Promise<O>;
  #accept!: (id: string) => void;
  #finish!: (value: O) => void;
  #fail!: (error: RcpError) => void;
  #listeners = new Set<() => void>();
  readonly #cancel: (command: Command<O, F>) => Promise<void>;

  constructor(path: string, cancel: (command: Command<O, F>) => Promise<void>) {
    this.path = path;
    this.#cancel = cancel;
    let refuse!: (error: RcpError) => void;
    this.accepted = new Promise((accept, reject) => {
      this.#accept = accept;
      refuse = reject;
    });
    this.result = new Promise((finish, reject) => {
      this.#finish = finish;
      this.#fail = (error) => {
        refuse(error);
        reject(error);
      };
    });
    // Who looks at one of them only is not to be told of an unhandled rejection of the other.
    this.accepted.catch(() => undefined);
    this.result.catch(() => undefined);
  }

  /** Whether it has ended. */
  get done(): boolean {
    return FINAL.has(this.status);
  }

  /** Have the robot told to stop; what became of it comes as `result`. */
  cancel(): Promise<void> {
    return this.#cancel(this);
  }

  /** Call back at each change; returns what ends it. */
  changed(listener: () => void): () => void {
    this.#listeners.add(listener);
    return () => this.#listeners.delete(listener);
  }

  async *[Symbol.asyncIterator](): AsyncGenerator<Feedback<F>> {
    let wake: (() => void) | undefined;
    let seen: F | undefined;
    const stop = this.changed(() => wake?.());
    try {
      while (!this.done) {
        await new Promise<void>((resolve) => (wake = resolve));
        if (this.feedback !== undefined && this.feedback !== seen) {
          seen = this.feedback;
          yield { body: this.feedback, progress: this.progress };
        }
      }
    } finally {
      stop();
    }
  }

  /** Take a reply; true if it was the last. */
  take(reply: Reply): boolean {
    this.status = reply.status;
    this.progress = reply.progress ?? this.progress;
    if (reply.command !== undefined) {
      this.id = reply.command;
      this.#accept(reply.command);
    }
    if (reply.status === "in_progress" && reply.body !== undefined) this.feedback = reply.body as F;
    const last = FINAL.has(reply.status);
    if (last && reply.error) this.#fail(new RcpError(withBody(reply.error, reply.body)));
    else if (last) this.#finish(reply.body as O);
    for (const listener of [...this.#listeners]) listener();
    return last;
  }

  /** The session it was started in is gone, or it was not sent: how it ends will not be told here. */
  lose(error: RcpError): void {
    this.status = "failed";
    this.#fail(error);
    for (const listener of [...this.#listeners]) listener();
  }
}

/** Add what a command brought about before it failed, such as the states of a plan's steps. */
function withBody(error: WireError, body: unknown): WireError {
  return body === undefined || body === null ? error : { ...error, details: { ...error.details, body } };
}
