import type { WireError } from "./wire.ts";

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
  constructor(message: string, remedy = "Wait for the connection, look at the robot, then ask again.") {
    super({ code: "connection_lost", message, remedy, origin: "client", retryable: true });
    this.name = "ConnectionLost";
  }
}
