"""Errors before the SDK is called, in the format of each binding."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from rcp_kernel.errors import RcpError
from rcp_web.asgi import JSON, Headers, Send, respond, retry_after

__all__ = ["NOT_FOUND", "NOT_TAKEN", "Binding", "Trouble", "refuse", "trouble_of"]

Binding = Literal["jsonrpc", "rest"]
_DOMAIN = "a2a-protocol.org"
_INFO = "type.googleapis.com/google.rpc.ErrorInfo"


class Trouble(msgspec.Struct, frozen=True):
    """What is wrong with a request."""

    http: int
    status: str
    """Code of google.rpc.Code."""
    reason: str
    rpc: int
    """JSON-RPC error code; those of this gateway start at -32050."""
    message: str
    metadata: dict[str, str] = {}


_BY_HTTP: dict[int, tuple[str, int]] = {
    400: ("INVALID_ARGUMENT", -32600),
    401: ("UNAUTHENTICATED", -32050),
    403: ("PERMISSION_DENIED", -32051),
    404: ("NOT_FOUND", -32601),
    405: ("UNIMPLEMENTED", -32601),
    408: ("DEADLINE_EXCEEDED", -32600),
    413: ("INVALID_ARGUMENT", -32600),
    415: ("INVALID_ARGUMENT", -32005),
    429: ("RESOURCE_EXHAUSTED", -32052),
    503: ("UNAVAILABLE", -32053),
}
NOT_FOUND = Trouble(404, "NOT_FOUND", "METHOD_NOT_FOUND", -32601, "nothing found at this address")
NOT_TAKEN = Trouble(
    405, "UNIMPLEMENTED", "METHOD_NOT_FOUND", -32601, "this address does not support the method"
)


def trouble_of(error: RcpError, http: int | None = None) -> Trouble:
    """Convert an error of the gateway to the protocol's."""
    status, rpc = _BY_HTTP.get(http or error.http, ("INTERNAL", -32603))
    facts = {"code": error.code}
    if error.remedy is not None:
        facts["remedy"] = error.remedy
    return Trouble(http or error.http, status, error.code.upper(), rpc, error.message, facts)


async def refuse(
    send: Send,
    trouble: Trouble,
    binding: Binding,
    id_: str | int | None = None,
    *,
    wait: float | None = None,
) -> None:
    """Respond to a refused request."""
    info = {
        "@type": _INFO,
        "reason": trouble.reason,
        "domain": _DOMAIN,
        "metadata": trouble.metadata,
    }
    body: dict[str, Any]
    if binding == "jsonrpc":
        error = {"code": trouble.rpc, "message": trouble.message, "data": [info]}
        body = {"jsonrpc": "2.0", "id": id_, "error": error}
    else:
        body = {
            "error": {
                "code": trouble.http,
                "status": trouble.status,
                "message": trouble.message,
                "details": [info],
            }
        }
    headers: Headers = retry_after(wait)
    if trouble.http == 401:
        headers.append((b"www-authenticate", b"Bearer"))
    if trouble.http in (408, 413):
        headers.append((b"connection", b"close"))  # the rest of the body is not read
    await respond(send, trouble.http, msgspec.json.encode(body), JSON, headers)
