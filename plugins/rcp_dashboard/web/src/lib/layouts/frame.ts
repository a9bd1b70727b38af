/** What a plugin's panel, in its sandboxed frame, may ask of the page, and what the page tells it. */

export const VERSION = 1;
const FASTEST = 20; // Hz of a subscription, and of requests
const USUAL = 5; // Hz

export interface Failure {
  code: string;
  message: string;
  remedy?: string | undefined;
}

/** What the page does for a frame; each is by the name that the plugin has declared. */
export interface Means {
  /** The path of what it reads; undefined: none was chosen. */
  reads: (name: string) => string | undefined;
  writes: (name: string) => string | undefined;
  watch: (path: string, rate: number, told: (update: { body: unknown; timestamp: string; seq: number }) => void) => () => void;
  read: (path: string) => Promise<{ value: unknown; timestamp?: string | undefined }>;
  /** Rejects with a `Failure` where the operator does not let it write. */
  write: (path: string, value: unknown) => Promise<unknown>;
  /** What `init` says. */
  about: () => Record<string, unknown>;
  post: (message: Record<string, unknown>) => void;
  /** In ms. */
  now: () => number;
}

const failure = (code: string, message: string, remedy?: string): Failure => ({ code, message, remedy });

const tooMany = (): Failure => failure("rate_limited", `a panel sends at most ${FASTEST} requests in a second`, "Send fewer.");

/** Answers one frame: it knows names, never paths, and has no token. */
export class FrameHost {
  readonly #means: Means;
  readonly #stops = new Map<string, () => void>();
  #times: number[] = [];

  constructor(means: Means) {
    this.#means = means;
  }

  /** Take a message of the frame; what is none of the protocol is left alone. */
  take(data: unknown): void {
    const message = (typeof data === "object" && data !== null ? data : {}) as Record<string, unknown>;
    if (message["rcp"] !== VERSION) return;
    const name = String(message["name"] ?? "");
    switch (message["type"]) {
      case "hello":
        return this.#takeOne() ? this.tell() : undefined;
      case "subscribe":
        return this.#subscribe(name, Number(message["rate"] ?? USUAL));
      case "unsubscribe":
        return this.#unsubscribe(name); // not counted: there is one for a subscription at most
      case "read":
        return void this.#answer(message["id"], () => this.#read(name));
      case "write":
        return void this.#answer(message["id"], () => this.#write(name, message["value"]));
    }
  }

  /** Tell the frame what it has, after its hello and whenever that changes. */
  tell(): void {
    this.#post({ type: "init", ...this.#means.about() });
  }

  close(): void {
    for (const stop of this.#stops.values()) stop();
    this.#stops.clear();
  }

  #post(message: Record<string, unknown>): void {
    this.#means.post({ rcp: VERSION, ...message });
  }

  /** Count a message; false if it is one too many: each costs the person at the page a part of what the gateway lets it ask. */
  #takeOne(): boolean {
    const now = this.#means.now();
    this.#times = this.#times.filter((one) => one > now - 1000);
    if (this.#times.length >= FASTEST) return false;
    this.#times.push(now);
    return true;
  }

  #unsubscribe(name: string): void {
    this.#stops.get(name)?.();
    this.#stops.delete(name);
  }

  #subscribe(name: string, rate: number): void {
    this.#unsubscribe(name);
    const path = this.#means.reads(name);
    if (!this.#takeOne()) return this.#post({ type: "ended", name, error: tooMany() });
    if (path === undefined) return this.#post({ type: "ended", name, error: this.#unknown(name) });
    const wanted = rate > 0 ? Math.min(rate, FASTEST) : USUAL;
    this.#stops.set(name, this.#means.watch(path, wanted, ({ body, timestamp, seq }) => this.#post({ type: "update", name, value: body, timestamp, seq })));
  }

  async #read(name: string): Promise<Record<string, unknown>> {
    const path = this.#means.reads(name);
    if (path === undefined) throw this.#unknown(name);
    return { ...(await this.#means.read(path)) };
  }

  async #write(name: string, value: unknown): Promise<Record<string, unknown>> {
    const path = this.#means.writes(name);
    if (path === undefined) throw this.#unknown(name);
    return { value: await this.#means.write(path, value) };
  }

  async #answer(id: unknown, work: () => Promise<Record<string, unknown>>): Promise<void> {
    try {
      if (!this.#takeOne()) throw tooMany();
      this.#post({ type: "reply", id, ...(await work()) });
    } catch (problem) {
      const { code, message, remedy } = problem as Failure;
      this.#post({ type: "reply", id, error: { code, message, remedy } });
    }
  }

  #unknown(name: string): Failure {
    return failure("unknown_path", `no path is given for '${name.slice(0, 64)}'`, "Choose one in the settings of the panel.");
  }
}
