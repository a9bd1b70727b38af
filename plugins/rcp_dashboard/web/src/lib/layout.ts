import { ask } from "./api.ts";

/** What the gateway keeps of how a user has laid the pages out; the paths and fields of each plot. */
export interface Layout {
  plots: string[][];
  seconds: number;
}

const MOST = 50; // plots, and lines of one
const DEFAULT = 30; // s

/** What of a document is a layout: another version of the page, or somebody by hand, may have written it. */
export function checked(found: unknown): Layout {
  const { plots, seconds } = (found ?? {}) as Record<string, unknown>;
  const texts = (one: unknown): string[] => (Array.isArray(one) ? one : []).filter((line) => typeof line === "string" && line.length < 4096);
  const kept = (Array.isArray(plots) ? plots : []).map((one) => [...new Set(texts(one))].slice(0, MOST)).filter((one) => one.some((line) => line.includes("#")));
  return { plots: kept.slice(0, MOST), seconds: typeof seconds === "number" && seconds > 0 && seconds <= 1800 ? seconds : DEFAULT };
}

export async function saveLayout(layout: Layout): Promise<void> {
  await ask("layout", { method: "PUT", body: JSON.stringify(layout) });
}

/** Raises `RcpError` where none is kept. */
export async function loadLayout(): Promise<Layout> {
  return checked(await ask("layout"));
}
