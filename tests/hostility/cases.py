"""The dearest request of each kind that the limits admit: data for the tests and the benchmark."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

__all__ = ["CASES", "KEYS", "Case", "Who"]

Who = Literal["anonymous", "operator", "auditor", "surveyor"]
KEYS: dict[Who, str | None] = {
    "anonymous": None,
    "operator": "operator-of-the-attack",
    "auditor": "auditor-of-the-attack",
    "surveyor": "surveyor-of-the-attack",
}
_MCP = "2026-07-28"


@dataclass(frozen=True)
class Case:
    """One kind of request, sent again and again as fast as the gateway takes it."""

    name: str
    how: Literal["ws", "http", "connect", "ws-connect"]
    """Over one WebSocket, one HTTP connection, or a new connection for each."""
    made: Callable[[int], Any]
    """Makes the n-th: an envelope, or method, path, body and headers."""
    who: tuple[Who, ...] = ("anonymous", "operator")
    at_once: int = 4
    """Written together."""
    gap: str | None = None
    """Why the tests leave it out: what is known to hold others up still."""


def _read(**more: Any) -> Callable[[int], dict[str, Any]]:
    return lambda n: {"type": "read", "id": f"r{n}", **more}


def _batch(part: Callable[[int], dict[str, Any]], size: int = 256) -> Callable[[int], Any]:
    parts = [part(number) for number in range(size)]
    return lambda n: {"type": "batch", "id": f"b{n}", "body": parts}


JOINTS = "sensor.joints"
_PAIR = f"{JOINTS}.all(x, {JOINTS}.all(y, {{n}} < 0 || x > y))"


def _plan(steps: list[dict[str, Any]], **more: Any) -> Callable[[int], Any]:
    return lambda n: {
        "type": "execute",
        "path": "/system/plans",
        "id": f"p{n}",
        "body": {"steps": [{"do": "parallel", "steps": steps}]},
        **more,
    }


def _waits(text: str, count: int = 130) -> list[dict[str, Any]]:
    return [{"do": "wait", "until": text.format(n=n), "deadline": 2} for n in range(count)]


def _subscribe_wide(n: int) -> dict[str, Any]:
    patterns = ["/tenant/*/**/sensor/**"] * 100
    return {
        "type": "subscribe",
        "id": f"s{n}",
        "body": {"paths": patterns, "rate": 1},
    }


def _subscribe_filtered(n: int) -> dict[str, Any]:
    terms = [{"field": "position.x", "gt": k} for k in range(60)]
    body = {"where": {"or": terms}, "rate": 50}
    return {"type": "subscribe", "id": f"f{n}", "path": "/sensor/pose", "body": body}


def _subscribe_and_back(n: int) -> dict[str, Any]:
    if n % 2:
        return {"type": "unsubscribe", "id": f"u{n}", "body": {"subscription": f"s{n - 1}"}}
    return {"type": "subscribe", "id": f"s{n}", "path": "/sensor/**", "body": {"history": 16}}


def _segments(n: int) -> dict[str, Any]:
    body = "A" * 65_536
    return {
        "type": "segment", "id": f"g{n // 16}", "num": n % 16, "total": 16,
        "size": 16 * 49_152, "sha256": hashlib.sha256(b"no").hexdigest(), "body": body,
    }  # fmt: skip


def _mcp(method: str, **params: Any) -> Callable[[int], Any]:
    meta = {
        "io.modelcontextprotocol/protocolVersion": _MCP,
        "io.modelcontextprotocol/clientInfo": {"name": "attack", "version": "1"},
        "io.modelcontextprotocol/clientCapabilities": {},
    }
    name = params.get("name")
    headers = {
        "accept": "application/json, text/event-stream",
        "mcp-protocol-version": _MCP,
        "mcp-method": method,
    } | ({"mcp-name": name} if name else {})
    body = {"jsonrpc": "2.0", "id": 1, "method": method, "params": {**params, "_meta": meta}}
    return lambda _n: ("POST", "/mcp", body, headers)


def _a2a(n: int) -> Any:
    steps = [{"do": "parallel", "steps": _waits(_PAIR, 60)}]
    part = {"data": {"steps": steps}, "mediaType": "application/json"}
    message = {"messageId": f"m{n}", "role": "ROLE_USER", "parts": [part]}
    params = {"message": message, "configuration": {"returnImmediately": True}}
    body = {"jsonrpc": "2.0", "id": 1, "method": "SendMessage", "params": params}
    return "POST", "/a2a/alpha", body, {"a2a-version": "1.0"}


def _a2a_values(n: int) -> Any:
    method, path, body, headers = _a2a(n)
    body["params"]["message"]["parts"][0]["data"] = {"steps": [1] * 4_000}
    return method, path, body, headers


def _get(path: str) -> Callable[[int], Any]:
    return lambda _n: ("GET", path, None, {"accept-encoding": "gzip"})


def _listed(n: int) -> Any:
    if n % 4 == 0:  # there is always something long to list
        return "POST", "/rcp/v1/context/service/echo", "x" * 30_000, {}
    return "GET", "/rcp/v1/commands?limit=1000", None, {"accept-encoding": "gzip"}


_DEAR = _waits(_PAIR)
_CELL = "[" + ",".join(["1"] * 50) + "]"
_REFUSED = _waits(f"{_CELL}.all(x, {_CELL}.all(y, {_CELL}.all(z, {{n}} < 0)))", 50)
_OPERATOR: tuple[Who, ...] = ("operator",)
_AUDITOR: tuple[Who, ...] = ("auditor",)
_SURVEYOR: tuple[Who, ...] = ("surveyor",)
_DEEP: list[Any] = [  # as much as `[limits] values` lets through, and some that it refuses
    [json.loads("[" * 60 + "]" * 60)] * 480,
    [{"a": 1}] * 16_000,
    ["\\", '"', ",[{"] * 28_000,
    "QUFB" * 1_600_000,
    [[]] * 3_000_000,
]
_ODD: list[Any] = [
    [None] * 260_000,
    [2**60] * 28_000,
    [1.5, 2**60] * 25_000,
    [0.1234567890123456] * 260_000,
    [[None]] * 25_000,
]

CASES = (
    Case("read of a 5 MB map", "ws", _read(path="/sensor/map")),
    Case("read of a 5 MB list", "http", _get("/rcp/v1/context/sensor/grid")),
    Case("read of a pattern", "ws", _read(path="/**", body={"limit": 1000})),
    Case("fresh read of a pattern", "ws", _read(path="/**", body={"limit": 1000, "fresh": True})),
    Case("discover with schemas", "ws", lambda n: {
        "type": "discover", "id": f"d{n}", "path": "/**", "body": {"limit": 1000}}),
    Case("discover by words", "http", _get("/rcp/v1/discovery?path=/**&q=zz%20yy&limit=1000")),
    Case("batch of map reads", "ws", _batch(_read(path="/sensor/map"))),
    Case("batch of pattern reads", "ws", _batch(_read(path="/**"))),
    Case("batch of discoveries", "ws", _batch(lambda n: {
        "type": "discover", "id": f"d{n}", "path": "/**", "body": {"limit": 1000}})),
    Case("batch of plans", "ws", _batch(_plan(_DEAR[:60]), 40), _OPERATOR),
    Case("batch of dry-run plans", "ws",
         _batch(_plan(_DEAR[:60], dry_run=True), 40), _OPERATOR),
    Case("subscribe to many patterns", "ws", _subscribe_wide),
    Case("subscribe with filters", "ws", _subscribe_filtered),
    Case("subscribe to 20,000 paths, and go", "ws-connect", lambda n: {
        "type": "subscribe", "id": f"s{n}", "path": "/sensor/**"}, _SURVEYOR),
    Case("subscribe to 20,000 paths, and unsubscribe", "ws", _subscribe_and_back, _SURVEYOR),
    Case("subscribe with history", "ws", lambda n: {
        "type": ("subscribe", "unsubscribe")[n % 2], "id": "s", "path": "/system/audit",
        "body": {"history": 1000} if n % 2 == 0 else {}}, _AUDITOR),
    Case("write storm", "ws", lambda n: {
        "type": "write", "id": f"w{n}", "path": "/param/any", "body": [n] * 1000},
        _OPERATOR, 1000),
    Case("small write storm", "ws", lambda n: {
        "type": "write", "id": f"w{n}", "path": "/actuator/drive", "body": {}},
        _OPERATOR, 4000),
    Case("execute storm", "ws", lambda n: {
        "type": "execute", "id": f"x{n}", "path": "/service/echo", "body": n}, _OPERATOR, 2000),
    Case("ping storm", "ws", lambda n: {"type": "ping", "id": f"i{n}"}, at_once=4000),
    Case("plans", "ws", _plan(_DEAR), _OPERATOR, 100),
    Case("plans over HTTP", "connect", lambda n: (
        "POST", "/rcp/v1/context/system/plans", _plan(_DEAR)(n)["body"], {}), _OPERATOR, 1),
    Case("plans that are refused", "connect", lambda n: (
        "POST", "/rcp/v1/context/system/plans", _plan(_REFUSED)(n)["body"], {}), _OPERATOR, 1),
    Case("dry runs of plans", "ws", _plan(_DEAR, dry_run=True), _OPERATOR, 100),
    Case("approvals", "ws", lambda n: {
        "type": "execute", "id": f"a{n}", "path": "/action/ask", "body": ["x" * 200] * 50},
        _OPERATOR, 200),
    Case("audit and history", "ws", lambda n: {
        "type": "read", "id": f"h{n}",
        "path": ("/system/audit", "/system/commands", "/system/log")[n % 3]}, _AUDITOR, 50),
    Case("list of commands", "http", _listed, _OPERATOR),
    Case("hello storm", "ws-connect", lambda n: {"type": "hello", "id": f"h{n}", "body": {}}),
    Case("wrong resumes", "ws-connect", lambda n: {"type": "hello", "id": f"h{n}", "body": {
        "session": "x" * 32, "resume_token": "y" * 64, "resume_from": {
            f"/sensor/text-{k:04}": 1 for k in range(1000)}}}),
    Case("MCP tools/list", "http", _mcp("tools/list")),
    Case("MCP tools/call", "http", _mcp("tools/call", name="discover", arguments={})),
    Case("A2A message with a plan", "http", _a2a, _OPERATOR),
    Case("A2A message with many values", "http", _a2a_values, _OPERATOR),
    Case("OpenAPI", "http", _get("/rcp/v1/openapi.json")),
    Case("metrics", "http", _get("/metrics"), _AUDITOR),
    Case("SSE connects", "connect", _get("/rcp/v1/events?path=/**")),
    Case("segments", "ws", _segments, at_once=32),
    Case("deep and odd bodies", "ws", lambda n: {
        "type": "write", "id": f"o{n}", "path": "/param/any", "body": _DEEP[n % len(_DEEP)]},
         _OPERATOR, 1),
    Case("deep and odd bodies over HTTP", "http", lambda n: (
        "PUT", "/rcp/v1/context/param/any", _DEEP[n % len(_DEEP)], {}), _OPERATOR, 1),
    Case("odd inputs", "ws", lambda n: {
        "type": "execute", "id": f"o{n}", "path": "/service/echo", "body": _ODD[n % len(_ODD)]},
         _OPERATOR, 1),
)  # fmt: skip
