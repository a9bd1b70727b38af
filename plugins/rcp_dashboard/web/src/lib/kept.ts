/** What the browser keeps for this page, as far as it does: it may be forbidden to, full, or hold what is none of ours. */
const here = new Map<string, string>();

function tried<T>(what: () => T): T | undefined {
  try {
    return what();
  } catch {
    return undefined; // the page goes on with what it has in memory
  }
}

/** Return what is kept for this tab, else for this computer. */
export function kept(key: string): string | null {
  return here.get(key) ?? tried(() => sessionStorage.getItem(key)) ?? tried(() => localStorage.getItem(key)) ?? null;
}

/** Keep it for this tab, or on this computer; at least as long as this page lives. */
export function keep(key: string, value: string, where: "tab" | "computer"): void {
  forget(key);
  here.set(key, value);
  tried(() => (where === "tab" ? sessionStorage : localStorage).setItem(key, value));
}

export function forget(key: string): void {
  here.delete(key);
  tried(() => sessionStorage.removeItem(key));
  tried(() => localStorage.removeItem(key));
}
