"""Notifications: the tree has changed, or a resource has a new value.

Clients of 2026-07-28 listen with one request; older ones subscribe within their session. Changes
are detected in each caller's own view of the tree, so that nobody is notified of what they may not
see.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

import structlog
from mcp import types
from mcp.server.subscriptions import ListenHandler
from mcp.shared.exceptions import MCPError
from mcp.shared.subscriptions import (
    ResourcesListChanged,
    ResourceUpdated,
    ServerEvent,
    ToolsListChanged,
)

from rcp_gateway.api import Session
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import RcpError
from rcp_mcp.caller import session_of
from rcp_mcp.catalogue import Catalogue
from rcp_mcp.feed import ResourceFeed
from rcp_mcp.naming import path_of
from rcp_mcp.offers import Context

__all__ = ["ListenerRegistry", "ResourceListener"]

log = structlog.get_logger("rcp.mcp")
_LOOK = 0.25  # s between checks of the tree
_RATE = 1.0  # Hz, maximum rate of notifications per resource
_BACKLOG = 256  # events
_LONGEST = 2048  # characters of a URI
Emit = Callable[[ServerEvent], None]
Open = Callable[[Emit], Callable[[], None]]


class ResourceListener:
    """One listening client."""

    def __init__(
        self,
        client_api: ClientApi,
        catalogue: Catalogue,
        session: Session,
        emit: Emit,
        uris: frozenset[str] = frozenset(),
    ) -> None:
        self._client_api = client_api
        self._catalogue = catalogue
        self._session = session
        self._emit = emit
        self.uris = uris
        self._generation = client_api.generation(session)
        self._task: asyncio.Task[None] | None = None
        self._listen()

    def look(self) -> None:
        """Notify the client if its view of the tree has changed."""
        generation = self._client_api.generation(self._session)
        if generation != self._generation:
            self._generation = generation
            self._emit(ToolsListChanged())
            self._emit(ResourcesListChanged())
            self._listen()

    def change(self, *, add: str | None = None, remove: str | None = None) -> None:
        """Add or remove a resource."""
        self.uris = (self.uris | {add} if add is not None else self.uris) - {remove or ""}
        self._listen()

    def close(self) -> None:
        """Stop listening."""
        if self._task is not None:
            self._task.cancel()
            self._task = None

    def _listen(self) -> None:
        """Subscribe to the existing resources; later ones are added at the next change."""
        self.close()
        paths: dict[str, str] = {}
        for uri in sorted(self.uris):
            path = path_of(uri)
            facts = None if path is None else self._catalogue.find(self._session, path)
            if path is not None and facts is not None and "subscribe" in facts["operations"]:
                paths[path] = uri
        if paths:
            self._task = asyncio.get_running_loop().create_task(self._follow(paths))

    async def _follow(self, paths: dict[str, str]) -> None:
        try:
            feed = ResourceFeed(self._client_api, self._session)
        except RcpError as error:
            log.warning("mcp_cannot_listen", error=error.message)
            return
        try:
            reply = await feed.subscribe([*paths], rate=_RATE, initial=False)
            while reply.error is None:
                updates = await feed.next()
                if not updates:
                    return
                for path in dict.fromkeys(path for path, _ in updates):
                    self._emit(ResourceUpdated(paths[path]))
        finally:
            feed.close()


class _Bus:
    """The notifications of one listener, in the form that the SDK's handler expects."""

    def __init__(self, open_: Open) -> None:
        self._open = open_

    async def publish(self, event: ServerEvent) -> None:
        """Never called: there are no notifications for all listeners."""

    def subscribe(self, listener: Emit) -> Callable[[], None]:
        """Start; return a function that stops it."""
        return self._open(listener)


class ListenerRegistry:
    """All listening clients."""

    def __init__(self, client_api: ClientApi, catalogue: Catalogue, most: int) -> None:
        self._client_api = client_api
        self._catalogue = catalogue
        self._most = most
        """Resources of one listener, which need not exist."""
        self._ears: dict[object, ResourceListener] = {}
        self._handlers: set[ListenHandler] = set()
        self._looking: asyncio.Task[None] | None = None
        self._senders: set[asyncio.Task[None]] = set()

    async def listen(
        self, ctx: Context, params: types.SubscriptionsListenRequestParams
    ) -> types.SubscriptionsListenResult:
        """Serve `subscriptions/listen` until the client leaves.

        :raises MCPError: it lists too many resources.
        """
        session = session_of(ctx)
        uris = frozenset(params.notifications.resource_subscriptions or ())
        self._check(uris)

        def open_(deliver: Emit) -> Callable[[], None]:
            key = object()
            self._add(
                key, ResourceListener(self._client_api, self._catalogue, session, deliver, uris)
            )
            return lambda: self._remove(key)

        handler = ListenHandler(_Bus(open_), max_buffered_events=_BACKLOG)
        self._handlers.add(handler)
        try:
            return await handler(ctx, params)
        finally:
            self._handlers.discard(handler)

    async def greeted(self, ctx: Context, params: types.NotificationParams) -> None:
        """Start to notify a client of an older version, once it is initialised."""
        connection: Any = ctx.session._connection  # noqa: SLF001  # pyright: ignore[reportPrivateUsage] - the SDK has no other way to a connection's end
        queue: asyncio.Queue[ServerEvent] = asyncio.Queue(_BACKLOG)

        def emit(event: ServerEvent) -> None:
            with suppress(asyncio.QueueFull):  # the client reads the lists anyway
                queue.put_nowait(event)

        ear = ResourceListener(self._client_api, self._catalogue, session_of(ctx), emit)
        self._add(connection, ear)
        sending = asyncio.get_running_loop().create_task(_send(connection, queue.get))
        self._senders.add(sending)
        sending.add_done_callback(self._senders.discard)
        connection.exit_stack.callback(self._remove, connection)
        connection.exit_stack.callback(sending.cancel)

    async def subscribe(
        self, ctx: Context, params: types.SubscribeRequestParams
    ) -> types.EmptyResult:
        """Serve `resources/subscribe`; hidden resources are treated like unknown ones.

        :raises MCPError: the client has too many.
        """
        ear = self._ears.get(ctx.session._connection)  # noqa: SLF001  # pyright: ignore[reportPrivateUsage] - as above
        self._check((ear.uris if ear is not None else frozenset()) | {params.uri})
        self._change(ctx, add=params.uri)
        return types.EmptyResult()

    async def unsubscribe(
        self, ctx: Context, params: types.UnsubscribeRequestParams
    ) -> types.EmptyResult:
        """Serve `resources/unsubscribe`."""
        self._change(ctx, remove=params.uri)
        return types.EmptyResult()

    def _check(self, uris: frozenset[str]) -> None:
        """Check what a client listens to.

        :raises MCPError: it is too much.
        """
        if len(uris) > self._most:
            text = (
                f"a client listens to at most {self._most} resources, and these are {len(uris)}: list fewer, "
                "unsubscribe from some first, or raise `subscriptions` in `[plugins.mcp]` of the gateway"
            )
            raise MCPError(types.INVALID_PARAMS, text)
        if any(len(uri) > _LONGEST for uri in uris):
            text = f"a URI has at most {_LONGEST} characters"
            raise MCPError(types.INVALID_PARAMS, text)

    def _change(self, ctx: Context, **change: str) -> None:
        ear = self._ears.get(ctx.session._connection)  # noqa: SLF001  # pyright: ignore[reportPrivateUsage] - as above
        if ear is not None:
            ear.change(**change)

    def _add(self, key: object, ear: ResourceListener) -> None:
        self._ears[key] = ear
        if self._looking is None:
            self._looking = asyncio.get_running_loop().create_task(self._look())

    def _remove(self, key: object) -> None:
        ear = self._ears.pop(key, None)
        if ear is not None:
            ear.close()
        if not self._ears and self._looking is not None:
            self._looking.cancel()
            self._looking = None

    async def _look(self) -> None:
        """Check the tree as each listener sees it, periodically while there are listeners."""
        while True:
            await asyncio.sleep(_LOOK)
            for ear in list(self._ears.values()):
                ear.look()

    def close(self) -> None:
        """End every stream."""
        for handler in list(self._handlers):
            handler.close()
        for sender in list(self._senders):
            sender.cancel()
        for key in list(self._ears):
            self._remove(key)


async def _send(connection: Any, next_: Callable[[], Awaitable[ServerEvent]]) -> None:
    """Send a client of an older version its notifications."""
    while True:
        event = await next_()
        if isinstance(event, ToolsListChanged):
            await connection.send_tool_list_changed()
        elif isinstance(event, ResourcesListChanged):
            await connection.send_resource_list_changed()
        elif isinstance(event, ResourceUpdated):
            await connection.send_resource_updated(event.uri)
