import { RcpError } from "rcp-client";

import { app, BASE } from "./app.svelte.ts";

/** Ask the dashboard's own interface, below `/dashboard/api`; raises `RcpError` as it answers. */
export async function ask(what: string, options: RequestInit = {}): Promise<unknown> {
  const headers = { "content-type": "application/json", ...(app.token && { authorization: `Bearer ${app.token}` }) };
  const answer = await fetch(`${BASE}/dashboard/api/${what}`, { ...options, headers });
  const text = await answer.text();
  try {
    const told = text ? JSON.parse(text) : undefined;
    if (answer.ok) return told;
    throw new RcpError(told.error);
  } catch (error) {
    if (error instanceof RcpError) throw error;
    throw new RcpError({ code: "internal", message: `unexpected response, not from the gateway: HTTP ${answer.status}` });
  }
}
