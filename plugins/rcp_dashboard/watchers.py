"""The recorded fields: rings, filled by subscriptions with the requester's own rights.

Each client has a connection like any other, so the gateway decides what it may see; it is opened at
the first request and closed after a time without any.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import msgspec
from msgspec import Raw

from rcp_dashboard.config import DashboardConfig
from rcp_dashboard.ring import Ring
from rcp_gateway.api import Field, Peer, Principal
from rcp_gateway.client_api import ClientApi
from rcp_kernel.clock import parse_time
from rcp_kernel.errors import BY_CODE, QueueFull, RcpError
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Reply, Request

__all__ = ["Watcher", "Watchers", "checked"]

Key = tuple[str, str]
"""Path and field."""
Owner = tuple[Principal, str | None, Peer]
_BURST = 1024  # samples that may arrive in one turn of the loop without loss
_REPLAYED = 10_000  # samples of the gateway's own ring that a new one starts with


class _Message(msgspec.Struct):
    """The needed fields of a message."""

    type: str
    id: str = ""
    timestamp: str = ""
    body: Any = None
    status: str = ""
    code: str = ""


_decode = msgspec.msgpack.Decoder(_Message).decode


class Watched:
    """One field with its ring."""

    __slots__ = ("field", "id", "requested_at", "ring")

    def __init__(self, id_: str, field: str, size: int, requested_at: float) -> None:
        self.id = id_
        self.field = Field(field)
        self.ring = Ring(size)
        self.requested_at = requested_at
        """Time of the last request, by the loop's clock."""

    def take(self, message: _Message) -> None:
        """Record the field of an update."""
        value = self.field.one(message.body)
        if isinstance(value, (int, float)):
            number = float(value)
            if math.isfinite(number):
                self.ring.add(parse_time(message.timestamp) / 1e9, number)
                return
        self.ring.skipped += 1


class Watcher:
    """The recorded fields of one client."""

    def __init__(
        self,
        client_api: ClientApi,
        config: DashboardConfig,
        owner: Owner,
        make_room: Callable[[], None],
    ) -> None:
        principal, tenant, peer = owner
        self._make_room = make_room
        self._client_api = client_api
        self._config = config
        self.watched: dict[Key, Watched] = {}
        self._by_id: dict[str, Watched] = {}
        self._number = 0
        self._connection = client_api.connect(principal, Encoding.MSGPACK, self._take, tenant, peer)

    @property
    def ended(self) -> bool:
        """Whether the gateway has ended the session because the credentials expired."""
        return self._connection.closed or self._connection.expelled

    async def ring(self, path: str, field: str) -> Ring:
        """Return the ring of a field; recording starts with the first request.

        :raises RcpError: the gateway refuses the subscription.
        :raises QueueFull: the client, or all clients together, have reached the limit.
        """
        now = self._client_api.loop.time()
        found = self.watched.get((path, field))
        if found is None:
            if len(self.watched) >= self._config.fields:
                raise QueueFull(
                    f"this client already has {len(self.watched)} recorded fields",
                    remedy=f"Request fewer; recording stops {self._config.idle:g} s after the "
                    "last request.",
                )
            self._make_room()
            found = await self._watch(path, field, now)
        found.requested_at = now
        return found.ring

    async def _watch(self, path: str, field: str, now: float) -> Watched:
        self._number += 1
        made = Watched(f"w{self._number}", field, self._config.samples, now)
        self.watched[path, field] = self._by_id[made.id] = made
        body: dict[str, Any] = {
            "history": min(_REPLAYED, self._config.samples),
            "qos": {"depth": _BURST},
        }
        if field:
            body["fields"] = [field]
        request = Request(
            type="subscribe", path=path, id=made.id, body=Raw(msgspec.json.encode(body))
        )
        try:
            checked(await self._client_api.request(self._connection.session, request))
        except RcpError:
            self._forget((path, field))
            raise
        self._take()  # the resource's ring has been copied
        return made

    def _take(self) -> None:
        outbox = self._connection.outbox
        while messages := outbox.collect():
            for data in messages:
                message = _decode(data)
                watched = self._by_id.get(message.id)
                if watched is None:
                    continue
                if message.type == "update":
                    watched.take(message)
                elif message.type != "notice":  # the subscription has ended
                    self._forget_id(message.id)

    def _forget_id(self, id_: str) -> None:
        for key, watched in list(self.watched.items()):
            if watched.id == id_:
                self._forget(key)

    def _forget(self, key: Key) -> None:
        watched = self.watched.pop(key, None)
        if watched is not None:
            self._by_id.pop(watched.id, None)

    def sweep(self, before: float) -> None:
        """Stop recording fields that were not requested for a while."""
        for key, watched in list(self.watched.items()):
            if watched.requested_at < before:
                self._forget(key)
                request = Request(type="unsubscribe", id=watched.id)
                self._client_api.submit(self._connection.session, request, _nobody)

    def close(self) -> None:
        """Stop all recordings."""
        self.watched.clear()
        self._by_id.clear()
        self._connection.close()


class Watchers:
    """The watchers of all clients."""

    def __init__(self, client_api: ClientApi, config: DashboardConfig) -> None:
        self._client_api = client_api
        self._config = config
        self._found: dict[Owner, Watcher] = {}
        self._timer: Any = None

    def of(self, principal: Principal, tenant: str | None, peer: Peer) -> Watcher:
        """Return the watcher of a client.

        :raises QueueFull: the gateway has too many sessions.
        :raises Forbidden: the client has no rights in that tenant.
        """
        owner = principal, tenant, peer
        found = self._found.get(owner)
        if found is not None and found.ended:
            self._found.pop(owner).close()
            found = None
        if found is None:
            found = self._found[owner] = Watcher(
                self._client_api, self._config, owner, self._check_room
            )
        if self._timer is None:
            self._timer = self._client_api.loop.call_later(self._config.idle / 2, self._sweep)
        return found

    def _check_room(self) -> None:
        if sum(len(one.watched) for one in self._found.values()) >= self._config.all_fields:
            raise QueueFull(
                f"the dashboard already records {self._config.all_fields} fields",
                remedy="Try again later, or ask the operator to raise [plugins.dashboard] "
                "all_fields.",
                retry_after=self._config.idle,
            )

    def _sweep(self) -> None:
        before = self._client_api.loop.time() - self._config.idle
        for owner, watcher in list(self._found.items()):
            watcher.sweep(before)
            if not watcher.watched or watcher.ended:
                self._found.pop(owner).close()
        self._timer = None
        if self._found:
            self._timer = self._client_api.loop.call_later(self._config.idle / 2, self._sweep)

    def close(self) -> None:
        """Stop all recordings."""
        if self._timer is not None:
            self._timer.cancel()
        for watcher in self._found.values():
            watcher.close()
        self._found.clear()


def _nobody(_: Reply) -> None:
    """Ignore a reply."""


def checked(reply: Reply) -> Reply:
    """Return a reply that is not a refusal.

    :raises RcpError: the reply is an error, which is raised.
    """
    described = reply.error
    if described is None:
        return reply
    kind = BY_CODE.get(described["code"], RcpError)
    error = kind(
        described["message"],
        path=described.get("path"),
        origin=described.get("origin"),
        remedy=described.get("remedy"),
        retry_after=described.get("retry_after"),
        details=described.get("details"),
    )
    error.retryable = described.get("retryable", error.retryable)
    error.trace_id = described.get("trace_id")
    raise error
