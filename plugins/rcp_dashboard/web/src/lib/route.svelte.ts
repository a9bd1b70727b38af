import { untrack } from "svelte";

/** The page that is shown, kept behind the `#` of the address: so it works below any path prefix. */
class Route {
  page = $state("");
  /** What the address says behind the page, between slashes. */
  rest = $state.raw<string[]>([]);
  query = $state.raw(new URLSearchParams());
  #read = ""; // the address that these two are from

  constructor() {
    const read = (): void => {
      this.#read = location.hash;
      const [place = "", query = ""] = this.#read.replace(/^#\/?/, "").split("?");
      const [page = "", ...rest] = place.split("/");
      this.page = page;
      this.rest = rest.map(decoded);
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
    const place = untrack(() => [this.page, ...this.rest.map(encodeURIComponent)].join("/"));
    history.replaceState(null, "", `#/${place}${text && `?${text}`}`);
    this.#read = location.hash;
    return true;
  }
}

function decoded(text: string): string {
  try {
    return decodeURIComponent(text);
  } catch {
    return text; // written by hand
  }
}

export const route = new Route();
