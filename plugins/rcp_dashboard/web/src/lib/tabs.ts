/** The tabs of one browser share a login: a new one asks the others, and a logout is for all that have the same token, or the cookie. */

const WAIT = 150; // ms that another tab may take to answer

interface Message {
  /** The gateway that it is about: others may be on the same origin. */
  base: string;
  kind: "ask" | "token" | "logout";
  token?: string;
}

export class Tabs {
  readonly #base: string;
  readonly #channel: BroadcastChannel | undefined;
  #asked: ((token: string) => void) | undefined;

  /** `own` is the token of this tab, `cookie` whether it has none and goes by the cookie; `ended` is told when it was logged out in another. */
  constructor(base: string, own: () => string | null, cookie: () => boolean, ended: () => void) {
    this.#base = base;
    if (typeof BroadcastChannel === "undefined") return;
    this.#channel = new BroadcastChannel("rcp.login");
    this.#channel.onmessage = ({ data }: MessageEvent<Message>) => {
      if (data?.base !== base) return;
      const token = own();
      if (data.kind === "ask" && token !== null) this.#send("token", token);
      if (data.kind === "token" && data.token) this.#asked?.(data.token);
      if (data.kind === "logout" && (data.token === undefined ? cookie() : data.token === token)) ended();
    };
  }

  /** Ask the other tabs for their token. */
  async token(): Promise<string | undefined> {
    if (!this.#channel) return undefined;
    const found = await new Promise<string | undefined>((resolve) => {
      this.#asked = resolve;
      setTimeout(() => resolve(undefined), WAIT);
      this.#send("ask");
    });
    this.#asked = undefined;
    return found;
  }

  /** Tell the other tabs that this token is logged out, or without one, the cookie. */
  logOut(token?: string): void {
    this.#send("logout", token);
  }

  #send(kind: Message["kind"], token?: string): void {
    this.#channel?.postMessage({ base: this.#base, kind, ...(token !== undefined && { token }) } satisfies Message);
  }
}
