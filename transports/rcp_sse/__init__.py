"""Server-sent events: updates, a command's replies and the status as HTTP streams."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

from rcp_gateway.api import to_internal_error
from rcp_gateway.client_api import Asgi, ClientApi, Mount
from rcp_gateway.client_kinds import TransportKind
from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.errors import BadRequest, UnknownPath, UnsupportedOperation
from rcp_kernel.values import Encoding
from rcp_kernel.wire import encode_reply
from rcp_sse.config import SseConfig
from rcp_sse.events import Events, Refusal
from rcp_sse.openapi import described
from rcp_sse.replies import Replies
from rcp_web.asgi import Receive, Scope, Send, header, refuse, respond, retry_after, status_of

__all__ = ["SseConfig", "open_sse", "rcp_transports"]

_EVENTS = "/rcp/v1/events"
_STATUS = "/rcp/v1/status/events"
_COMMANDS = "/rcp/v1/commands"
_TAIL = "/events"
_ALLOW = b"GET, OPTIONS"


class _Sse:
    """The ASGI application behind the three mounts."""

    def __init__(self, client_api: ClientApi, events: Events, replies: Replies) -> None:
        self._client_api = client_api
        self._events = events
        self._replies = replies

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            if scope["method"] == "OPTIONS":
                await respond(send, 204, b"", headers=[(b"allow", _ALLOW)])
                return
            _check(scope)
            await self._serve(scope, receive, send)
        except Refusal as refusal:
            body = encode_reply(refusal.reply, Encoding.JSON)
            headers = retry_after((refusal.reply.error or {}).get("retry_after"))
            await respond(send, status_of(refusal.reply), body, headers=headers)
        except Exception as error:
            told = to_internal_error(error, path=scope["path"])
            self._client_api.refused("subscribe", told.code)
            allow = [(b"allow", _ALLOW)] if told.http == 405 else []
            await refuse(send, told, "subscribe", headers=allow)

    async def _serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        path: str = scope["path"]
        if path == _EVENTS:
            await self._events.serve(scope, receive, send)
        elif path == _STATUS:
            await self._events.serve(scope, receive, send, "/system/status")
        elif path.startswith(_COMMANDS) and path.count("/") == _COMMANDS.count("/") + 2:
            id_ = path[len(_COMMANDS) + 1 : -len(_TAIL)]
            await self._replies.serve(scope, receive, send, id_)
        else:
            raise UnknownPath(f"nothing found at {path}")


def _check(scope: Scope) -> None:
    if scope["method"] != "GET":
        raise UnsupportedOperation(f"{scope['path']} does not support {scope['method']}")
    accept = header(scope, b"accept")
    if accept is not None and not any(
        name in accept for name in (b"text/event-stream", b"text/*", b"*/*")
    ):
        raise BadRequest("this is a stream", remedy="Accept text/event-stream.")


@asynccontextmanager
async def open_sse(config: SseConfig, client_api: ClientApi) -> AsyncGenerator[dict[str, Any]]:
    """Mount the streams in the listener while entered."""
    events = Events(config, client_api)
    app: Asgi = _Sse(client_api, events, Replies(config, client_api))

    async with AsyncExitStack() as stack:
        stack.callback(events.close)
        for mount in (
            Mount(name="sse", prefix=_EVENTS, app=app, openapi=described),
            Mount(name="sse", prefix=_STATUS, app=app),
            Mount(name="sse", prefix=_COMMANDS, suffix=_TAIL, app=app),
        ):
            client_api.mount(mount)
            stack.callback(client_api.unmount, mount)
        yield {"path": _EVENTS}


@hookimpl
def rcp_transports() -> Iterable[TransportKind]:
    """Provide server-sent events."""
    return [TransportKind("sse", SseConfig, open_sse, __doc__ or "")]
