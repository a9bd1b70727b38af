"""The gRPC binding: a server of its own beside the listener, for the same tasks.

Each call is authenticated, charged and takes its turn as over HTTP; a stop skips the queue.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterable, Awaitable, Callable
from contextlib import asynccontextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TypeVar

import grpc
import grpc.aio
import msgspec
from a2a.server.context import ServerCallContext
from a2a.server.request_handlers import RequestHandler
from a2a.server.request_handlers.grpc_handler import GrpcHandler
from a2a.types import a2a_pb2_grpc
from a2a.types.a2a_pb2 import CancelTaskRequest, SendMessageRequest
from a2a.utils.errors import VersionNotSupportedError
from google.protobuf.message import Message
from msgspec import Raw

from rcp_a2a.callers import Caller, context_of
from rcp_a2a.config import GrpcConfig
from rcp_a2a.messages import VALUES, count_values, parse_message
from rcp_a2a.stops import PLANS, SHORT
from rcp_gateway.api import Session, to_internal_error
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import ConfigError, PayloadTooLarge, RateLimited, RcpError
from rcp_kernel.wire import Request
from rcp_web.asgi import bearer

__all__ = ["serving_grpc"]

_GRACE = 2.0  # s for calls under way when the gateway stops
_STEP = 250  # values that take a whole turn
_CODES = {
    400: grpc.StatusCode.INVALID_ARGUMENT,
    401: grpc.StatusCode.UNAUTHENTICATED,
    403: grpc.StatusCode.PERMISSION_DENIED,
    404: grpc.StatusCode.NOT_FOUND,
    413: grpc.StatusCode.RESOURCE_EXHAUSTED,
    429: grpc.StatusCode.RESOURCE_EXHAUSTED,
    503: grpc.StatusCode.UNAVAILABLE,
}
_CALLER: ContextVar[Caller] = ContextVar("caller")
"""The caller of the call that a task handles."""
Item = TypeVar("Item")
Context = grpc.aio.ServicerContext


class _Agent(GrpcHandler):
    """The SDK's handler, on behalf of an authenticated caller."""

    def __init__(self, client_api: ClientApi, handler: RequestHandler, base: str) -> None:
        super().__init__(handler)
        self._client_api = client_api
        self._base = base

    async def _handle_unary(
        self,
        request: Message,
        context: Context,
        handler_func: Callable[[ServerCallContext], Awaitable[Item]],
        default_response: Item,
    ) -> Item:
        await self._admit(request, context)
        return await super()._handle_unary(request, context, handler_func, default_response)

    async def _handle_stream(
        self,
        request: Message,
        context: Context,
        handler_func: Callable[[ServerCallContext], AsyncIterable[Item]],
    ) -> AsyncGenerator[Item, None]:
        session = await self._admit(request, context)
        task = asyncio.current_task()
        assert task is not None
        # A stream ends with its client's credentials.

        def end(_error: RcpError) -> None:
            task.cancel()

        forget = self._client_api.until_end(session, end)
        try:
            async for item in super()._handle_stream(request, context, handler_func):
                yield item
        finally:
            forget()

    def _build_call_context(self, context: Context, request: Message) -> ServerCallContext:
        given = _metadata(context)
        # Without a version it is that of the service's own definition, which is 1.0 alone.
        version = given.get("a2a-version") or "1.0"
        if version.split(".")[:2] != ["1", "0"]:
            raise VersionNotSupportedError(f"A2A {version} is not served over gRPC, only 1.0")
        made = context_of(_CALLER.get(), given)
        made.tenant = getattr(request, "tenant", "")
        return made

    async def _admit(self, request: Message, context: Context) -> Session:
        """Authenticate and charge a call; one that is refused ends here."""
        try:
            return await self._admitted(request, context)
        except Exception as error:
            internal = to_internal_error(error, path="grpc")
            self._client_api.refused("a2a", internal.code)
            await _refuse(context, internal)
            raise AssertionError from error

    async def _admitted(self, request: Message, context: Context) -> Session:
        given = _metadata(context)
        authorization = given.get("authorization")
        token = bearer(None if authorization is None else authorization.encode("latin-1"))
        tenant = getattr(request, "tenant", "") or given.get("x-rcp-tenant")
        client_api = self._client_api
        session = client_api.session(await client_api.identify(token), tenant or None)
        body = parse_message(request).body if isinstance(request, SendMessageRequest) else None
        values = count_values(body, VALUES)
        if values > VALUES:
            raise PayloadTooLarge(
                f"the request has more than {VALUES} values",
                remedy="Send a long plan as text, a command in each line, or as several plans.",
            )
        stops = self._stops(session, request, body)
        try:
            client_api.charge(session)
        except RateLimited:
            if not stops:
                raise
        for _ in range(1 + values // _STEP):
            await client_api.turns.place((session.principal.identity, stops))
        _CALLER.set(Caller(session, self._base, stops=stops))
        return session

    def _stops(self, session: Session, request: Message, body: Any) -> bool:
        """Return whether a call stops something; it then skips its caller's queue."""
        if request.ByteSize() > SHORT:
            return False
        if isinstance(request, CancelTaskRequest):
            return True
        if body is None:
            return False
        plan = Request(type="execute", path=PLANS, body=Raw(msgspec.json.encode(body)))
        return self._client_api.is_stop(session, plan)


async def _refuse(context: Context, error: RcpError) -> None:
    """End a call with the gateway's error."""
    message = error.message if error.remedy is None else f"{error.message}. {error.remedy}"
    if error.retry_after is not None:
        context.set_trailing_metadata((("retry-after", f"{error.retry_after:g}"),))
    await context.abort(_CODES.get(error.http, grpc.StatusCode.INTERNAL), message)


def _metadata(context: Context) -> dict[str, str]:
    found = context.invocation_metadata() or ()
    return {key.lower(): value for key, value in found if isinstance(value, str)}


@asynccontextmanager
async def serving_grpc(
    config: GrpcConfig, client_api: ClientApi, handler: RequestHandler, most: int
) -> AsyncGenerator[int]:
    """Serve while entered; returns the port. `most` is the longest request, in bytes.

    :raises ConfigError: the certificate cannot be read, or the address cannot be used.
    """
    server = grpc.aio.server(options=(("grpc.max_receive_message_length", most),))
    secure = config.certificate is not None
    base = f"{'https' if secure else 'http'}://{config.host}:{config.port}"
    agent = _Agent(client_api, handler, base)
    a2a_pb2_grpc.add_A2AServiceServicer_to_server(agent, server)  # pyright: ignore[reportUnknownMemberType]
    address = f"{config.host}:{config.port}"
    try:
        if secure:
            port = server.add_secure_port(address, _credentials(config))
        else:
            port = server.add_insecure_port(address)
    except RuntimeError as error:
        raise ConfigError(f"[plugins.a2a.grpc]: cannot listen on {address}: {error}") from None
    await server.start()
    try:
        yield port
    finally:
        await server.stop(_GRACE)


def _credentials(config: GrpcConfig) -> grpc.ServerCredentials:
    assert config.certificate is not None
    assert config.key is not None
    try:
        pair = Path(config.key).read_bytes(), Path(config.certificate).read_bytes()
    except OSError as error:
        raise ConfigError(f"[plugins.a2a.grpc]: cannot be read: {error}") from None
    return grpc.ssl_server_credentials([pair])
