/** Where the gateway is, or the hubs of its fleet: the first that answers is used until it is lost. */
export class Addresses {
  readonly #urls: string[];
  #at = 0;
  /** How many are left to try before a pause. */
  #left: number;
  /** Where the session was begun. */
  #home: string | undefined;

  /** `urls` has commas between them. */
  constructor(urls: string) {
    this.#urls = urls.split(",").map((url) => url.trim());
    this.#left = this.#urls.length;
  }

  get several(): boolean {
    return this.#urls.length > 1;
  }

  /** The address of the WebSocket to try now. */
  get current(): string {
    const url = new URL(this.#urls[this.#at] as string);
    url.protocol = url.protocol.replace("http", "ws");
    url.pathname = `${url.pathname.replace(/\/+$/, "")}/rcp/v1/ws`;
    return url.href;
  }

  /** Note the end of a connection; true if an address is to be tried without a pause. */
  lost(stood: boolean): boolean {
    if (stood) {
      this.#left = this.#urls.length;
      return this.several;
    }
    this.#at = (this.#at + 1) % this.#urls.length;
    this.#left -= 1;
    if (this.#left > 0) return true;
    this.#left = this.#urls.length;
    return false;
  }

  /** Note that a session has begun; true if the one before was elsewhere. */
  begun(): boolean {
    const before = this.#home;
    this.#home = this.current;
    return before !== undefined && before !== this.#home;
  }
}
