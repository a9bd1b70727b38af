import type { Reply, Notice, Request, Update } from "./wire.ts";

export type Incoming = Reply | Update | Notice;

const SUBPROTOCOL = "rcp.v1.json";

/** One connection, from its opening to its one end. */
export class Link {
  readonly #socket: WebSocket;
  #over = false;

  constructor(
    url: string,
    on: { open: () => void; message: (message: Incoming) => void; closed: (why: string) => void },
  ) {
    this.#socket = new WebSocket(url, [SUBPROTOCOL]);
    const end = (why: string): void => {
      if (this.#over) return;
      this.#over = true;
      on.closed(why);
    };
    this.#socket.onopen = () => on.open();
    this.#socket.onmessage = (event) => on.message(JSON.parse(event.data as string) as Incoming);
    this.#socket.onclose = (event) => end(event.reason || `the connection was closed (${event.code})`);
    this.#socket.onerror = () => end("the gateway cannot be reached");
    this.close = (why) => {
      this.#socket.close(1000);
      end(why);
    };
  }

  /** End it now: a peer that is gone would let the closing handshake wait. */
  readonly close: (why: string) => void;

  /** Bytes that were sent and have not left this machine. */
  get waiting(): number {
    return this.#socket.bufferedAmount;
  }

  send(request: Request): void {
    this.#socket.send(JSON.stringify(request));
  }
}

/** Waits between tries to connect, in ms: doubling, and spread so that many clients do not come at once. */
export class Backoff {
  #tries = 0;
  readonly #first: number;
  readonly #most: number;

  constructor(first = 250, most = 5000) {
    this.#first = first;
    this.#most = most;
  }

  next(): number {
    const wait = Math.min(this.#most, this.#first * 2 ** this.#tries++);
    return wait * (0.75 + Math.random() / 4);
  }

  reset(): void {
    this.#tries = 0;
  }
}
