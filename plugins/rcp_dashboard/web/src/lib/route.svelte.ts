import { untrack } from "svelte";

/** The page that is shown, kept behind the `#` of the address: so it works below any path prefix. */
class Route {
  page = $state("");
  query = $state.raw(new URLSearchParams());

  constructor() {
    const read = (): void => {
      const [page = "", query = ""] = location.hash.replace(/^#\/?/, "").split("?");
      this.page = page;
      this.query = new URLSearchParams(query);
    };
    addEventListener("hashchange", read);
    read();
  }

  /** Change what the address says beside the page, without a step in the history. */
  set(change: Record<string, string | undefined>): void {
    const query = new URLSearchParams(untrack(() => this.query)); // who sets it does not follow it
    for (const [key, value] of Object.entries(change)) {
      if (value === undefined || value === "") query.delete(key);
      else query.set(key, value);
    }
    const text = query.toString();
    history.replaceState(null, "", `#/${untrack(() => this.page)}${text && `?${text}`}`);
    this.query = query;
  }
}

export const route = new Route();
