import type { RcpError } from "./errors.ts";
import type { Notice, SubscribeOptions, Update } from "./wire.ts";

export interface Handlers<T> {
  update: (update: Update<T>) => void;
  notice?: (notice: Notice) => void;
  /** It stands no more: refused when it was made anew, overrun, or its count or duration is over. */
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
  ended = false;
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
    await this.#end(this);
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
