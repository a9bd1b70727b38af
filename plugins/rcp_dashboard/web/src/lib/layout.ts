import { ask } from "./api.ts";

/** What the gateway keeps of how a user has laid the pages out; the paths and fields of each plot. */
export interface Layout {
  plots: string[][];
  seconds: number;
}

export async function saveLayout(layout: Layout): Promise<void> {
  await ask("layout", { method: "PUT", body: JSON.stringify(layout) });
}

/** Raises `RcpError` where none is kept. */
export async function loadLayout(): Promise<Layout> {
  const { plots, seconds } = (await ask("layout")) as Partial<Layout>;
  return { plots: plots ?? [], seconds: seconds ?? 30 };
}
