import { BASE } from "./app.svelte.ts";

const quoted = (text: string): string => `'${text.replaceAll("'", `'\\''`)}'`;

/** The same request for a shell; the token stays out of it. */
export function asCurl(path: string, operation: "read" | "write" | "execute", value?: unknown): string {
  const how = { read: "", write: "-X PUT ", execute: "-X POST " }[operation];
  const body = operation === "read" ? "" : `-d ${quoted(JSON.stringify(value ?? null))} `;
  return `curl ${how}-H "Authorization: Bearer $RCP_TOKEN" ${body}${quoted(`${BASE}/rcp/v1/context${path}`)}`;
}

export function asRcpctl(path: string, operation: "read" | "write" | "execute", value?: unknown): string {
  const body = operation === "read" ? "" : ` ${quoted(JSON.stringify(value ?? null))}`;
  return `rcpctl --url ${BASE} ${operation} ${path}${body}`;
}
