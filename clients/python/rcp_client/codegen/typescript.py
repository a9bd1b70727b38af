"""TypeScript output: interfaces, maps from path to type, and a small client over HTTP and SSE.

The npm package `rcp-client` uses the same maps to check paths and values.

Only erasable syntax is used, so that Node and bundlers run it unchanged.
"""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from rcp_client.codegen.types import Record, Shape, Types, one_line
from rcp_client.messages import ResourceInfo

__all__ = ["write_typescript"]

_WORDS = {
    "any": "unknown",
    "null": "null",
    "bool": "boolean",
    "int": "number",
    "uint": "number",
    "float": "Float",
    "str": "string",
    "bytes": "Base64",
}
_RESERVED = ("Values", "Writes", "Commands", "Gateway", "Update", "Reply", "Rcp", "RcpError", "Float",
             "Base64", "Record", "Promise", "Array", "AsyncGenerator", "Error")  # fmt: skip


def write_typescript(resources: list[ResourceInfo], url: str) -> str:
    """Generate the module."""
    types = Types()
    for word in _RESERVED:
        types.take_name(word)
    values: list[tuple[str, str, str]] = []
    writes: list[tuple[str, str, str]] = []
    commands: list[tuple[str, str, str]] = []
    for resource in resources:
        schemas, note = resource.schemas, one_line(resource.description)
        value = schemas.get("value") or schemas.get("output")
        if {"read", "subscribe"} & set(resource.operations):
            text = _text(types.shape(value, inward=False)) if value else "unknown"
            values.append((resource.path, text, note))
        if "write" in resource.operations:
            text = _text(types.shape(value, inward=True)) if value else "unknown"
            writes.append((resource.path, text, note))
        if "execute" in resource.operations:
            taken = _text(types.shape(schemas.get("input"), inward=True))
            given = _text(types.shape(schemas.get("output"), inward=False))
            fed = _text(types.shape(schemas.get("feedback"), inward=False))
            text = f"{{ input: {taken}; output: {given}; feedback: {fed} }}"
            commands.append((resource.path, text, note))
    parts = [
        _HEAD.replace("URL", one_line(url)),
        *map(_record, types.records.values()),
        _map("Values", "What can be read and watched, by path.", values),
        _map("Writes", "What can be written, by path.", writes),
        _map("Commands", "What can be executed, by path.", commands),
        _GATEWAY,
        _CLIENT,
    ]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _quoted(text: str) -> str:
    return msgspec.json.encode(text).decode()


def _text(shape: Shape) -> str:
    match shape.kind:
        case "literal":
            return " | ".join(msgspec.json.encode(value).decode() for value in shape.values)
        case "list":
            return f"Array<{_text(shape.parts[0])}>"
        case "map":
            return f"Record<string, {_text(shape.parts[0])}>"
        case "union":
            return " | ".join(map(_text, shape.parts))
        case "name":
            return shape.name
        case kind:
            return _WORDS[kind]


def _record(record: Record) -> str:
    lines = [f"/** {record.note} */"] if record.note else []
    lines.append(f"export interface {record.name} {{")
    for field in record.fields:
        if field.note:
            lines.append(f"  /** {field.note} */")
        mark = "?" if field.optional else ""
        lines.append(f"  {_quoted(field.name)}{mark}: {_text(field.shape)};")
    return "\n".join([*lines, "}"])


def _map(name: str, about: str, rows: Iterable[tuple[str, str, str]]) -> str:
    lines = [f"/** {about} */", f"export interface {name} {{"]
    for path, text, note in rows:
        if note:
            lines.append(f"  /** {note} */")
        lines.append(f"  {_quoted(path)}: {text};")
    return "\n".join([*lines, "}"])


_HEAD = """
// Typed client of the gateway at URL, written by `rcpctl codegen --lang typescript`.
//
//   const robot = new Rcp("URL", token);
//   const value = await robot.read(path);

/** A number; those that JSON cannot write come as text. */
export type Float = number | "NaN" | "Infinity" | "-Infinity";

/** Bytes in base64. */
export type Base64 = string;
"""

_GATEWAY = """
/** All of it, for the package `rcp-client`: `new Client<Gateway>({ url, token })`. */
export interface Gateway {
  values: Values;
  writes: Writes;
  commands: Commands;
}
"""

_CLIENT = """
/** One sample of a watched path. */
export interface Update<T> {
  path: string;
  seq: number;
  timestamp: string;
  body: T;
  dropped?: number;
}

interface Reply {
  status: string;
  body?: unknown;
  command?: string;
  message?: string;
  error?: { code: string; message: string; remedy?: string };
}

/** What the gateway refused or failed to do, by its code. */
export class RcpError extends Error {
  code: string;
  remedy: string;
  constructor(code: string, message: string, remedy: string) {
    super(message);
    this.code = code;
    this.remedy = remedy;
  }
}

const FINAL = ["completed", "failed", "rejected", "cancelled"];

/** The gateway, over HTTP and server-sent events. */
export class Rcp {
  private base: string;
  private headers: Record<string, string>;

  constructor(url: string, token?: string) {
    this.base = url.replace(/\\/+$/, "") + "/rcp/v1";
    this.headers = token === undefined ? {} : { Authorization: `Bearer ${token}` };
  }

  async read<P extends keyof Values>(path: P): Promise<Values[P]> {
    return (await this.ask("GET", `/context${path}`)).body as Values[P];
  }

  async write<P extends keyof Writes>(path: P, value: Writes[P], validFor?: number): Promise<unknown> {
    const query = validFor === undefined ? "" : `?valid_for=${validFor}`;
    return (await this.ask("PUT", `/context${path}${query}`, value)).body;
  }

  /** Carries a command out and returns its result; `signal` has it cancelled. */
  async execute<P extends keyof Commands>(
    path: P,
    input: Commands[P]["input"],
    signal?: AbortSignal,
  ): Promise<Commands[P]["output"]> {
    let reply = await this.ask("POST", `/context${path}`, input);
    const command = reply.command;
    while (!FINAL.includes(reply.status)) {
      if (signal?.aborted) {
        await this.ask("DELETE", `/commands/${command}`);
      }
      await new Promise((done) => setTimeout(done, 200));
      reply = (await this.ask("GET", `/commands/${command}`)).body as Reply;
    }
    return Rcp.checked(reply).body as Commands[P]["output"];
  }

  /** Yields each new value of a path until the loop is left. */
  async *watch<P extends keyof Values>(path: P, rate?: number): AsyncGenerator<Update<Values[P]>> {
    const query = new URLSearchParams({ path });
    if (rate !== undefined) {
      query.set("rate", String(rate));
    }
    const stop = new AbortController();
    const response = await fetch(`${this.base}/events?${query}`, {
      headers: this.headers,
      signal: stop.signal,
    });
    if (!response.ok || response.body === null) {
      Rcp.checked((await response.json()) as Reply);
      throw new RcpError("internal", `HTTP ${response.status}`, "");
    }
    const reader = response.body.getReader();
    const decoder = new TextDecoder();
    let text = "";
    try {
      for (;;) {
        const { done, value } = await reader.read();
        if (done) {
          return;
        }
        text += decoder.decode(value, { stream: true }).replace(/\\r\\n?/g, "\\n");
        const events = text.split("\\n\\n");
        text = events.pop() ?? "";
        for (const event of events) {
          const lines = event.split("\\n");
          if (lines.includes("event: update")) {
            const data = lines.filter((line) => line.startsWith("data: "));
            yield JSON.parse(data.map((line) => line.slice(6)).join("\\n")) as Update<Values[P]>;
          }
        }
      }
    } finally {
      stop.abort();
    }
  }

  private async ask(method: string, path: string, body?: unknown): Promise<Reply> {
    const response = await fetch(this.base + path, {
      method,
      headers: body === undefined ? this.headers : { ...this.headers, "Content-Type": "application/json" },
      body: body === undefined ? null : JSON.stringify(body),
    });
    return Rcp.checked((await response.json()) as Reply);
  }

  private static checked(reply: Reply): Reply {
    if (reply.error !== undefined) {
      throw new RcpError(reply.error.code, reply.error.message, reply.error.remedy ?? "");
    }
    return reply;
  }
}
"""
