import type { Codec, Reply, Notice, Request, Update } from "./wire.ts";

export type Incoming = Reply | Update | Notice;

const JSON_ONLY = ["rcp.v1.json"];

/** Which encodings a connection can read, and which of them it asks for. */
export interface Encodings {
  codec?: Codec | undefined;
  preferred: "json" | "msgpack";
}

/** One connection, from its opening to its one end. */
export class Link {
  readonly #socket: WebSocket;
  readonly #encode: (request: Request) => string | Uint8Array<ArrayBuffer>;
  #over = false;

  constructor(
    url: string,
    encodings: Encodings,
    on: { open: () => void; message: (message: Incoming) => void; closed: (why: string) => void },
  ) {
    const { codec, preferred } = encodings;
    const wanted = codec && preferred === codec.name ? `rcp.v1.${codec.name}` : undefined;
    this.#socket = new WebSocket(url, wanted ? [wanted, ...JSON_ONLY] : JSON_ONLY);
    this.#socket.binaryType = "arraybuffer";
    this.#encode = (request) => (codec && this.#socket.protocol === wanted ? codec.encode(request) : JSON.stringify(request));
    const end = (why: string): void => {
      if (this.#over) return;
      this.#over = true;
      on.closed(why);
    };
    this.#socket.onopen = () => on.open();
    this.#socket.onmessage = ({ data }) => {
      if (typeof data === "string") on.message(JSON.parse(data) as Incoming);
      else if (codec) on.message(codec.decode(new Uint8Array(data as ArrayBuffer)) as Incoming);
      else this.close("a binary message came, and no codec was given");
    };
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

  /** Send a request; of a socket that is closing `closed` tells, and a browser complains of what is sent on it. */
  send(request: Request): void {
    if (this.#socket.readyState !== WebSocket.OPEN) return;
    this.#socket.send(this.#encode(request));
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
