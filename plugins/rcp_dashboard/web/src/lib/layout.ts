import { RcpError } from "rcp-client";

import { app, BASE } from "./app.svelte.ts";

/** What the gateway keeps of how a user has laid the pages out; the paths and fields of each plot. */
export interface Layout {
  plots: string[][];
  seconds: number;
}

const URL = `${BASE}/dashboard/api/layout`;

function headers(): Record<string, string> {
  return { "content-type": "application/json", ...(app.token && { authorization: `Bearer ${app.token}` }) };
}

async function checked(answer: Response): Promise<unknown> {
  const text = await answer.text();
  const told = text ? JSON.parse(text) : undefined;
  if (!answer.ok) throw new RcpError(told?.error ?? { code: "internal", message: `HTTP ${answer.status}` });
  return told;
}

export async function saveLayout(layout: Layout): Promise<void> {
  await checked(await fetch(URL, { method: "PUT", headers: headers(), body: JSON.stringify(layout) }));
}

/** Raises `RcpError` where none is kept. */
export async function loadLayout(): Promise<Layout> {
  const { plots, seconds } = (await checked(await fetch(URL, { headers: headers() }))) as Partial<Layout>;
  return { plots: plots ?? [], seconds: seconds ?? 30 };
}
