import { repeatable } from "./errors.ts";
import type { Reply, Request } from "./wire.ts";

/** What becomes of a request that was sent when another hub takes over: it is sent again; only if that knows its key; or never. */
export type Repeat = "always" | "keyed" | "never";

const NOT_YET = new Set(["adapter_unavailable", "unknown_path"]);

/** Give a request that acts a key of its own, by which robots' gateways know it whichever hub passes it on. */
export function keyed(request: Request): Request {
  if (repeatable(request) || ofGateway(request)) return request;
  const random = crypto.getRandomValues(new Uint8Array(16));
  return { ...request, idempotency_key: [...random].map((byte) => byte.toString(16).padStart(2, "0")).join("") };
}

/** Say what becomes of a request, as it was asked for. */
export function repeatOf(request: Request): Repeat {
  const acts = request.type === "write" || request.type === "execute";
  if (repeatable(request) && (!acts || request.idempotency_key === undefined)) return request.type === "cancel" ? "never" : "always";
  return ofGateway(request) ? "never" : "keyed";
}

/** Whether a hub does not reach the robot of a repeated request yet. */
export function notYet(reply: Reply): boolean {
  return reply.error !== undefined && NOT_YET.has(reply.error.code);
}

/** Whether a request asks something of the gateway itself, which another one knows nothing of. */
function ofGateway({ path = "" }: Request): boolean {
  return path.startsWith("/system/");
}
