import type { RcpError } from "./errors.ts";
import { Backoff } from "./link.ts";
import type { Notice, SubscribeOptions, Update } from "./wire.ts";

export interface Handlers<T> {
  update: (update: Update<T>) => void;
  notice?: (notice: Notice) => void;
  /** It stands no more: refused for good, overrun, or its count or duration is over. What is refused for now is asked for again. */
  ended?: (error: RcpError | undefined) => void;
}

/** A standing request for samples. It outlives cuts of the connection. */
export class Subscription<T = any> {
  readonly id: string;
  readonly paths: string[];
  readonly options: SubscribeOptions;
  /** What it reached when it was last made. */
  reaches: string[] = [];
  /** Whether the gateway's session has it. */
  made = false;
  /** Whether it has ever stood. */
  stood = false;
  ended = false;
  readonly #backoff = new Backoff(100);
  #again: ReturnType<typeof setTimeout> | undefined;
  readonly #handlers: Handlers<T>;
  readonly #end: (subscription: Subscription<T>) => Promise<void>;
  #seen = new Map<string, number>();

  constructor(
    id: string,
    paths: string[],
    options: SubscribeOptions,
    handlers: Handlers<T>,
    end: (subscription: Subscription<T>) => Promise<void>,
  ) {
    this.id = id;
    this.paths = paths;
    this.options = options;
    this.#handlers = handlers;
    this.#end = end;
  }

  /** End it. */
  async close(): Promise<void> {
    if (this.ended) return;
    this.ended = true;
    this.rest();
    await this.#end(this);
  }

  /** The gateway has it. */
  stand(): void {
    this.made = this.stood = true;
    this.#backoff.reset();
  }

  /** Call back when it is time for another try, in `seconds` at the earliest. */
  after(seconds: number | undefined, again: () => void): void {
    this.rest();
    this.#again = setTimeout(again, Math.max((seconds ?? 0) * 1000, this.#backoff.next()));
  }

  /** Try no more, until told to. */
  rest(): void {
    clearTimeout(this.#again);
  }

  /** The number of the last sample of each path. */
  get seen(): ReadonlyMap<string, number> {
    return this.#seen;
  }

  /** Take an update, unless it came already before a cut. */
  update(update: Update<T>): void {
    const last = this.#seen.get(update.path);
    if (this.ended || (last !== undefined && update.seq <= last)) return;
    this.#seen.set(update.path, update.seq);
    this.#handlers.update(update);
  }

  notice(notice: Notice): void {
    if (notice.code === "gap" && notice.reason === "restart") this.#seen.clear();
    this.#handlers.notice?.(notice);
  }

  /** Numbers begin anew: another run of the gateway, or another session. */
  forget(): void {
    this.made = false;
    this.#seen.clear();
  }

  over(error: RcpError | undefined): void {
    if (this.ended) return;
    this.ended = true;
    this.#handlers.ended?.(error);
  }
}
