import { untrack } from "svelte";

/** The page that is shown, kept behind the `#` of the address: so it works below any path prefix. */
class Route {
  page = $state("");
  query = $state.raw(new URLSearchParams());
  #read = ""; // the address that these two are from

  constructor() {
    const read = (): void => {
      this.#read = location.hash;
      const [page = "", query = ""] = this.#read.replace(/^#\/?/, "").split("?");
      this.page = page;
      this.query = new URLSearchParams(query);
    };
    addEventListener("hashchange", read);
    read();
  }

  /** Change what the address says beside the page, without a step in the history. */
  set(change: Record<string, string | undefined>): void {
    const query = new URLSearchParams(this.#read.split("?")[1] ?? ""); // with what was written beside it
    for (const [key, value] of Object.entries(change)) {
      if (value === undefined || value === "") query.delete(key);
      else query.set(key, value);
    }
    if (this.write(query)) this.query = query;
  }

  /** Have the address say so beside the page. Not if it leads elsewhere already, and the event that tells of it is still to come. */
  write(query: URLSearchParams): boolean {
    if (location.hash !== this.#read) return false;
    const text = query.toString();
    history.replaceState(null, "", `#/${untrack(() => this.page)}${text && `?${text}`}`);
    this.#read = location.hash;
    return true;
  }
}

export const route = new Route();
