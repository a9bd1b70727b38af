/** What stands in the messages of RCP/1, as docs/protocol.md has it. */

export type Operation = "read" | "write" | "execute" | "subscribe";
export type Kind = "sensor" | "actuator" | "param" | "action" | "service" | "event";
export type Final = "completed" | "failed" | "rejected" | "cancelled";
export type Status = "accepted" | "pending" | "in_progress" | Final;
export type Json = null | boolean | number | string | Json[] | { [key: string]: Json };

/** A JSON Schema (2020-12) with `unit` beside the standard's words. */
export type Schema = { [word: string]: any };

/** A way to write messages in bytes, beside JSON. */
export interface Codec {
  /** The protocol's word for it: `rcp.v1.<name>`. */
  readonly name: "msgpack";
  encode: (value: unknown) => Uint8Array<ArrayBuffer>;
  decode: (data: Uint8Array<ArrayBuffer>) => unknown;
}

export interface Request {
  type:
    | "read" | "write" | "execute" | "subscribe" | "unsubscribe" | "cancel"
    | "discover" | "status" | "hello" | "ping";
  id?: string;
  path?: string;
  body?: unknown;
  timestamp?: string;
  deadline?: number;
  idempotency_key?: string;
  valid_for?: number;
  dry_run?: boolean;
  /** Of the approval that lets a write or execute pass, once. */
  approval?: string;
  command?: string;
}

export interface WireError {
  code: string;
  message: string;
  origin?: string;
  path?: string;
  remedy?: string;
  retryable?: boolean;
  retry_after?: number;
  details?: Record<string, any>;
  trace_id?: string;
}

export interface Reply<T = any> {
  type: string;
  id?: string;
  path?: string;
  status: Status;
  body?: T;
  message?: string;
  error?: WireError;
  command?: string;
  progress?: number;
  seq?: number;
  source_timestamp?: string;
  state?: "fresh" | "stale";
  /** The body is one page of the answer; `cursor` leads to the next. */
  truncated?: boolean;
  cursor?: string;
  timestamp?: string;
  dry_run?: boolean;
}

/** One sample of a path that is subscribed to. */
export interface Update<T = any> {
  type: "update";
  id: string;
  path: string;
  seq: number;
  /** The source's time: ISO 8601 in UTC. */
  timestamp: string;
  body: T;
  /** Samples that were skipped since the last update of this path. */
  dropped?: number;
  /** The value is too long to be sent for a pattern: there is no `body`. `read` its path, or subscribe to it by name. */
  truncated?: true;
  /** With `truncated`: the bytes that the value has in this encoding. */
  size?: number;
}

/** What nobody asked for. Codes that are not known are to be ignored. */
export interface Notice {
  type: "notice";
  code: string;
  id?: string;
  path?: string;
  message?: string;
  reason?: string;
  error?: WireError;
  timestamp: string;
  [field: string]: unknown;
}

export interface Hello {
  version: string;
  session: string;
  resume_token: string;
  principal: string;
  roles: string[];
  tenant: string | null;
  tenants: string[];
  heartbeat: number;
  limits: Record<string, number>;
}

export interface Resource {
  path: string;
  kind: Kind;
  operations: Operation[];
  description: string;
  schemas?: { value?: Schema; input?: Schema; output?: Schema; feedback?: Schema };
  schema_ids: Record<string, string>;
  /** The schema of what this asker may send, where it is held to envelopes. */
  command_schema?: Schema;
  envelopes?: Record<string, unknown>[];
  examples: unknown[];
  backend: string;
  state: "fresh" | "stale" | "never" | "ready" | "down";
  unit?: string;
  deadline?: number;
  timeout?: number;
  policy?: "reject" | "queue" | "preempt" | "parallel";
  max_age?: number;
  valid_for?: number;
  /** The group of resources of its robot that can be written as one: `writeAll`. */
  atomic?: string;
  safe?: unknown;
  native?: unknown;
  meta?: Record<string, unknown>;
  /** The profiles of its robot that it is part of: `name/version`. */
  profiles?: string[];
  /** The frames to which its values, or from which its goals, are converted. */
  frames?: string[];
}

export interface Discovered {
  resources: Resource[];
  cursor?: string;
  generation: number;
  /** False while more may come from backends that are not open yet. */
  complete?: boolean;
}

export interface DiscoverOptions {
  kind?: Kind;
  op?: Operation;
  q?: string;
  /** Only what this profile of its robot defines: `mobile`, `mobile/1`. */
  profile?: string;
  limit?: number;
  cursor?: string;
  schemas?: boolean;
}

/** Filters and quality of service of a subscription. Times are in seconds, rates in Hz. */
export interface SubscribeOptions {
  rate?: number;
  on?: "sample" | "change";
  deadband?: number | string | Record<string, number | string>;
  where?: Record<string, unknown>;
  fields?: string[];
  /** The frame of the values: `map`, `base_link`, `earth`. */
  frame?: string;
  history?: number | string;
  initial?: boolean;
  duration?: number;
  count?: number;
  /** How its updates are written; the connection's encoding without it. Others than JSON need the client's `codec`. */
  encoding?: "json" | "msgpack";
  qos?: {
    reliability?: "best_effort" | "reliable";
    depth?: number;
    priority?: number;
    deadline?: number;
    lifespan?: number;
  };
}

export interface LeaseState {
  lease: string;
  scope: string;
  holder: string;
  session: string | null;
  priority: number;
  since: string;
  expires: string;
  reason?: string | null;
}

/** A latched robot, and how far its stop has come. */
export interface EstopRobot {
  state?: "requested" | "commanded" | "confirmed";
  requested?: string;
  commanded?: string | null;
  /** When it was measured to be at rest. */
  confirmed?: string | null;
  /** Why it is not confirmed. */
  detail?: string | null;
  /** It has moved again under the latch. */
  alarm?: boolean;
  [field: string]: unknown;
}

export interface EstopState {
  active: boolean;
  robots: Record<string, EstopRobot>;
  scopes: Record<string, Record<string, unknown>>;
  /** Groups of robots that can be named as a scope. */
  groups?: string[];
  /** When one of the robots was last reset since the gateway was started. */
  reset?: string | null;
}

/** How a robot was found after a hold. */
export interface Held {
  at_rest: boolean;
  detail: string;
}

/** One item of a read of a pattern. */
export interface Item<T = any> {
  path: string;
  status: Final;
  body?: T;
  seq?: number;
  timestamp?: string;
  state?: "fresh" | "stale";
  error?: WireError;
}

/** Types of the resources by path, as `rcpctl codegen --lang typescript` writes them. */
export interface Catalogue {
  values: object;
  writes: object;
  commands: object;
}

/** Any path, any value. */
export interface Untyped {
  values: Record<string, any>;
  writes: Record<string, any>;
  commands: Record<string, { input: any; output: any; feedback: any }>;
}

export const FINAL: ReadonlySet<string> = new Set<Status>([
  "completed", "failed", "rejected", "cancelled",
]);
