/** One sample of a watched path. */
export interface Update<T> {
  path: string;
  seq: number;
  timestamp: string;
  body: T;
  dropped?: number;
}

interface Reply {
  status: string;
  body?: unknown;
  command?: string;
  message?: string;
  error?: { code: string; message: string; remedy?: string };
}

/** What the gateway refused or failed to do, by its code. */
export class RcpError extends Error {
  code: string;
  remedy: string;
  constructor(code: string, message: string, remedy: string) {
    super(message);
    this.code = code;
    this.remedy = remedy;
  }
}

const FINAL = ["completed", "failed", "rejected", "cancelled"];

/** The gateway, over HTTP and server-sent events. */
export class Rcp {
  private base: string;
  private headers: Record<string, string>;

  constructor(url: string, token?: string) {
    this.base = url.replace(/\/+$/, "") + "/rcp/v1";
    this.headers = token === undefined ? {} : { Authorization: `Bearer ${token}` };
  }

  async read<P extends keyof Values>(path: P): Promise<Values[P]> {
    return (await this.ask("GET", `/context${path}`)).body as Values[P];
  }

  async write<P extends keyof Writes>(path: P, value: Writes[P], validFor?: number): Promise<unknown> {
    const query = validFor === undefined ? "" : `?valid_for=${validFor}`;
    return (await this.ask("PUT", `/context${path}${query}`, value)).body;
  }

  /** Carries a command out and returns its result; `signal` has it cancelled. */
  async execute<P extends keyof Commands>(
    path: P,
    input: Commands[P]["input"],
    signal?: AbortSignal,
  ): Promise<Commands[P]["output"]> {
    let reply = await this.ask("POST", `/context${path}`, input);
    const command = reply.command;
    while (!FINAL.includes(reply.status)) {
      if (signal?.aborted) {
        await this.ask("DELETE", `/commands/${command}`);
      }
      await new Promise((done) => setTimeout(done, 200));
      reply = (await this.ask("GET", `/commands/${command}`)).body as Reply;
    }
    return Rcp.checked(reply).body as Commands[P]["output"];
  }

  /** Yields each new value of a path until the loop is left. */
  async *watch<P extends keyof Values>(path: P, rate?: number): AsyncGenerator<Update<Values[P]>> {
    const query = new URLSearchParams({ path });
    if (rate !== undefined) {
      query.set("rate", String(rate));
    }
    const stop = new AbortController();
    const response = await fetch(`${this.base}/events?${query}`, {
      headers: this.headers,
      signal: stop.signal,
    });
    if (!response.ok || response.body === null) {
      Rcp.checked((await response.json()) as Reply);
      throw new RcpError("internal", `HTTP ${response.status}`, "");
    }
    const reader = response.body.getReader();
    const decoder = new TextDecoder();
    let text = "";
    try {
      for (;;) {
        const { done, value } = await reader.read();
        if (done) {
          return;
        }
        text += decoder.decode(value, { stream: true }).replace(/\r\n?/g, "\n");
        const events = text.split("\n\n");
        text = events.pop() ?? "";
        for (const event of events) {
          const lines = event.split("\n");
          if (lines.includes("event: update")) {
            const data = lines.filter((line) => line.startsWith("data: "));
            yield JSON.parse(data.map((line) => line.slice(6)).join("\n")) as Update<Values[P]>;
          }
        }
      }
    } finally {
      stop.abort();
    }
  }

  private async ask(method: string, path: string, body?: unknown): Promise<Reply> {
    const response = await fetch(this.base + path, {
      method,
      headers: body === undefined ? this.headers : { ...this.headers, "Content-Type": "application/json" },
      body: body === undefined ? null : JSON.stringify(body),
    });
    return Rcp.checked((await response.json()) as Reply);
  }

  private static checked(reply: Reply): Reply {
    if (reply.error !== undefined) {
      throw new RcpError(reply.error.code, reply.error.message, reply.error.remedy ?? "");
    }
    return reply;
  }
}
