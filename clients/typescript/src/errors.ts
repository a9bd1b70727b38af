import type { Request, WireError } from "./wire.ts";

/** What the gateway refused or failed to do, by its code, with what to do next. */
export class RcpError extends Error {
  readonly code: string;
  readonly remedy: string;
  readonly retryable: boolean;
  /** Seconds until another try makes sense. */
  readonly retryAfter: number | undefined;
  readonly origin: string;
  readonly path: string | undefined;
  readonly details: Record<string, any>;
  readonly traceId: string | undefined;

  constructor(error: WireError) {
    super(error.message);
    this.name = "RcpError";
    this.code = error.code;
    this.remedy = error.remedy ?? "";
    this.retryable = error.retryable ?? false;
    this.retryAfter = error.retry_after;
    this.origin = error.origin ?? "gateway";
    this.path = error.path;
    this.details = error.details ?? {};
    this.traceId = error.trace_id;
  }
}

/** The gateway cannot be reached, or was lost before it had answered. */
export class ConnectionLost extends RcpError {
  /** `retryable` is false where the request may have acted: a repeat could act once more. */
  constructor(message: string, remedy?: string, retryable = true) {
    remedy ??= retryable ? "Wait for the connection, then ask again." : LOOK;
    super({ code: "connection_lost", message, remedy, origin: "client", retryable });
    this.name = "ConnectionLost";
  }
}

/** The error of a command that was not sent: its age could not be told, or it was overtaken. */
export function withheld(why: string, code = "deadline_exceeded"): RcpError {
  const remedy = "Nothing was sent: send it again if it is still wanted.";
  return new RcpError({ code, message: why, origin: "client", remedy, retryable: true });
}

/** The error of a request that was sent and has no answer in time. */
export function unanswered(request: Request, seconds: number): RcpError {
  const message = `no answer within ${seconds} s`;
  const retryable = repeatable(request);
  const remedy = retryable ? "Ask again, with more time if it needs more." : LOOK;
  return new RcpError({ code: "deadline_exceeded", message, origin: "client", remedy, retryable });
}

/** Whether a request that was sent may be repeated without knowing what became of it: it does not act twice. */
export function repeatable(request: Request): boolean {
  return !acts(request) || request.idempotency_key !== undefined;
}

/** Whether a request changes something, and is more than a stop: carried out late, it may do harm. */
export function acts(request: Request): boolean {
  const { type, dry_run } = request;
  return (type === "write" || type === "execute") && dry_run !== true && !stops(request);
}

/** Whether all it does is to stop robots, which may be done twice; a late reset might undo the stop of somebody else. */
export function stops({ type, path = "", body }: Request): boolean {
  if (path === "/system/estop") return !(body as { reset?: boolean } | null | undefined)?.reset;
  return type === "execute" && HOLD.test(path);
}

const HOLD = /^(\/tenant\/[^/]+)?\/service\/([^/]+\/)?hold$/;

const LOOK = "What became of it is not known: look at the robot before you send it again.";
