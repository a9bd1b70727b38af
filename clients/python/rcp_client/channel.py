"""A session with a gateway, over any number of consecutive connections.

A lost connection is reopened with growing pauses; `hello` resumes the session, the gateway replays
missed messages, and `recovery` decides what happens to unanswered requests.
"""

from __future__ import annotations

import asyncio
import itertools
import logging
import random
import secrets
import time
from collections import deque
from collections.abc import Callable, Coroutine
from typing import Any

from rcp_client.address import Address
from rcp_client.calls import Call, Calls
from rcp_client.carrier import Carrier
from rcp_client.errors import ConnectionLost, error_of, safely
from rcp_client.link import Link
from rcp_client.messages import Codec, Message, Notice, Reply
from rcp_client.recovery import Recovery
from rcp_client.requests import Repeat
from rcp_client.settings import MARGIN, Settings
from rcp_client.subscriber import Subscriber
from rcp_client.tracing import with_trace
from rcp_protocol.clock import now
from rcp_protocol.errors import (
    DeadlineExceeded,
    Gap,
    RcpError,
    TokenExpired,
    Unauthenticated,
)
from rcp_protocol.timeouts import timeout

__all__ = ["Channel"]

log = logging.getLogger("rcp.client")
_SEGMENT = 256 * 1024  # bytes of one frame, which limits the delay of short messages


class Channel:
    """Sends requests, receives replies and updates."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.calls = Calls()
        self.listeners: list[Callable[[Notice], None]] = []
        """Called with every notice."""
        self.subscriptions: dict[str, Subscriber] = {}
        self.session: str | None = None
        self.greeting: dict[str, Any] = {}
        """The gateway's reply to the last `hello`."""
        self._addresses = deque((settings.address, *settings.others))
        """The current one first."""
        self._home: Address | None = None
        """Where the session began."""
        self._codec = Codec(settings.encoding)
        self._prefix = secrets.token_hex(4)
        self._numbers = itertools.count(1)
        self._resume_token: str | None = None
        self._link: Carrier | None = None
        self._greeted = False
        self._lost = asyncio.Event()
        self._keeper: asyncio.Task[None] | None = None
        self._over: RcpError | None = None
        self._recovery = Recovery(self, settings.patience)

    @property
    def address(self) -> Address:
        """The address in use, or the one that is tried next."""
        return self._addresses[0]

    @property
    def connected(self) -> bool:
        """Whether there is a connection that has completed its handshake."""
        return self._greeted and self._link is not None and not self._link.closed

    def new_id(self) -> str:
        """Return an id that no other client uses."""
        return f"{self._prefix}-{next(self._numbers)}"

    # -- lifetime ------------------------------------------------------------------------------

    async def open(self) -> None:
        """Connect for the first time.

        :raises ConnectionLost: the gateway cannot be reached.
        :raises Unauthenticated, Forbidden: it refuses this client.
        """
        await self._dial()
        for call in self.calls.every():  # begun before
            self.send(call)
        self._keeper = asyncio.create_task(self._keep(), name="rcp client")

    async def close(self) -> None:
        """Close the session; pending calls end with `ConnectionLost`."""
        self._over = self._over or ConnectionLost("the client was closed")
        if self._keeper is not None:
            self._keeper.cancel()
            await asyncio.gather(self._keeper, return_exceptions=True)
        link, self._link = self._link, None
        if link is not None:
            link.close()
        self._end(self._over)

    def _end(self, error: RcpError) -> None:
        self._over = error
        self._recovery.close()
        self.calls.fail(lambda call: _for_call(error, call))
        for subscription in list(self.subscriptions.values()):
            subscription.fail(error)

    async def _dial(self) -> bool:
        """Connect at the first address that answers; return whether the session was resumed."""
        left = len(self._addresses)
        while True:
            try:
                return await self._connect()
            except RcpError as error:
                left -= 1
                if not error.retryable:
                    raise
                self._addresses.rotate(-1)
                if not left:
                    raise

    async def _connect(self) -> bool:
        """Connect and send `hello`; return whether the session was resumed."""
        self._lost.clear()
        self._greeted = False
        self._link = link = await self._open_link()
        try:
            if link.closed:  # it was closed before it could be assigned
                raise ConnectionLost(link.why)
            resumed = await self._greet(link)
        except BaseException:
            link.close()
            raise
        self._greeted = True
        return resumed

    async def _open_link(self) -> Carrier:
        settings = self.settings
        if settings.dial is not None:
            return await settings.dial(self._codec, self._received, self._on_lost)
        return await Link.open(
            self.address,
            self._codec,
            settings.proof(),
            self._received,
            self._on_lost,
            patience=settings.connect_timeout,
            heartbeat=settings.heartbeat,
            ssl=settings.ssl if self.address.secure else None,
        )

    async def _greet(self, link: Carrier) -> bool:
        if self.session is not None:
            try:
                await self._hello(link, session=self.session)
            except (Gap, Unauthenticated) as error:
                if isinstance(error, TokenExpired):
                    raise
                await self._hello(link)  # the session has expired: begin a new one
                return False
            return True
        await self._hello(link)
        return False

    async def _hello(self, link: Carrier, session: str | None = None) -> None:
        settings = self.settings
        body: dict[str, Any] = {"client": settings.client}
        if settings.dial is None:
            body["segment_size"] = _SEGMENT
        if settings.tenant is not None:
            body["tenant"] = settings.tenant
        if settings.dial is not None and (token := settings.proof()) is not None:
            body["token"] = token
        if session is not None:
            body |= {"session": session, "resume_token": self._resume_token}
            body["resume_from"] = self._seen()
        requested = now()
        reply = await self._first(link, {"type": "hello", "body": body})
        facts: dict[str, Any] = reply.body or {}
        self.greeting = facts
        self.session = facts.get("session")
        self._resume_token = facts.get("resume_token")
        limits = facts.get("limits") or {}
        link.segment_size = limits.get("segment_size") or facts.get("segment_size")
        moved = session is None and self._home not in (None, self.address)
        self._home = self.address
        if reply.timestamp is not None:
            resumed = session is not None
            self._recovery.greeted(reply.timestamp, requested, resumed=resumed, moved=moved)

    async def _first(self, link: Carrier, envelope: dict[str, Any]) -> Reply:
        """Send a request on a link that is not in general use yet."""
        call = Call(envelope, "never")
        self.calls.enter(call)
        self._go(call, link)
        try:
            async with timeout(self.settings.connect_timeout):
                outcome = await call.end
        except TimeoutError:
            raise ConnectionLost(f"{self.address.url} does not answer `hello`") from None
        finally:
            self.calls.leave(call)
        return _outcome(outcome)

    def _seen(self) -> dict[str, int]:
        """Return the last number seen of each path, the lowest over all subscriptions."""
        seen: dict[str, int] = {}
        for subscription in self.subscriptions.values():
            for path, seq in subscription.seen.items():
                seen[path] = min(seq, seen.get(path, seq))
        return seen

    async def _keep(self) -> None:
        try:
            while True:
                await self._lost.wait()
                link = self._link
                self.tell(Notice(code="disconnected", message=link.why if link else None))
                resumed = await self._return()
                self.tell(Notice(code="reconnected", facts={"resumed": resumed}))
                await self._unless_lost(self._recovery.restore())
        except RcpError as error:
            self._end(error)
        except Exception as error:
            log.exception("the client failed")
            self._end(ConnectionLost(f"the client failed: {error!r}"))

    async def _unless_lost(self, work: Coroutine[Any, Any, None]) -> None:
        """Run work on the connection, and abandon it when the connection is lost again."""
        doing = asyncio.ensure_future(work)
        lost = asyncio.ensure_future(self._lost.wait())
        try:
            await asyncio.wait((doing, lost), return_when=asyncio.FIRST_COMPLETED)
        finally:
            lost.cancel()
            doing.cancel()
        if doing.done():
            doing.result()

    async def _return(self) -> bool:
        """Try to reconnect until it succeeds or patience ends."""
        settings = self.settings
        began, pause = time.monotonic(), settings.first_pause
        while True:
            try:
                return await self._dial()
            except ConnectionLost as error:
                away = time.monotonic() - began
                if settings.patience is not None and away + pause > settings.patience:
                    raise ConnectionLost(
                        f"the gateway has been unreachable for {away:.0f} s: {error.message}"
                    ) from error
            except RcpError as error:
                if not settings.persistent:
                    raise
                self.tell(Notice(code="refused", message=error.message))
            await asyncio.sleep(pause * random.uniform(0.5, 1.0))  # noqa: S311 - spreads clients
            pause = min(pause * 2, settings.longest_pause)

    # -- sending -------------------------------------------------------------------------------

    def start(self, envelope: dict[str, Any], repeat: Repeat, *, id_: str | None = None) -> Call:
        """Start a request; without a connection it waits for the next one.

        :raises RcpError: the client is closed, or the envelope cannot be encoded.
        """
        if self._over is not None:
            raise self._over
        call = Call(with_trace(envelope), repeat, id_)
        self.calls.enter(call)
        if self.connected:
            try:
                self.send(call)
            except BaseException:
                self.calls.leave(call)
                raise
        return call

    async def ask(self, envelope: dict[str, Any], repeat: Repeat = "always") -> Reply:
        """Send a request and return its final reply, within its deadline.

        :raises RcpError: it failed, was refused or cancelled, or no reply came.
        """
        deadline = envelope.setdefault("deadline", self.settings.deadline)
        call = self.start(envelope, repeat)
        return await self.finish(call, deadline + MARGIN)

    async def finish(self, call: Call, limit: float | None) -> Reply:
        """Wait for the end of a call.

        :raises RcpError: it failed, was refused or cancelled, or `limit` seconds have passed.
        """
        try:
            async with timeout(limit):
                outcome = await asyncio.shield(call.end)
        except TimeoutError:
            raise self.late(call, limit or 0) from None
        finally:
            self.calls.leave(call)
        return _outcome(outcome)

    def late(self, call: Call, limit: float) -> RcpError:
        """Return the error for a call without a reply in time."""
        path = call.envelope.get("path")
        if not self.connected:
            why = f"no connection to {self.address.url} within {limit:g} s"
            return call.unanswered(ConnectionLost(why, path=path))
        why = f"the gateway did not answer within {limit:g} s"
        return call.unanswered(DeadlineExceeded(why, path=path))

    def send(self, call: Call, **facts: Any) -> None:
        """Send a call, possibly again, with additional fields."""
        self._go(call, self._link, **facts)

    def is_current(self, link: object) -> bool:
        """Return whether this is the connection in use, and its handshake is complete."""
        return self.connected and link is self._link

    def calls_of_before(self) -> list[Call]:
        """List the unanswered calls that were not sent on the current connection."""
        before = [call for call in self.calls.every() if call.link is not self._link]
        # The session reports the outcome of an accepted command by itself.
        return [c for c in before if c.command is None or c.session != self.session]

    def _go(self, call: Call, link: Carrier | None, **facts: Any) -> None:
        """Send a call under a new id, or under its fixed id."""
        id_ = call.fixed or self.new_id()
        self.calls.name(call, id_)
        call.sent = call.sent or now()
        call.link = link
        if call.command is None:
            call.session = self.session
        if link is not None:
            link.send({**call.envelope, "id": id_, **facts})

    def later(self, envelope: dict[str, Any]) -> None:
        """Send a request without waiting for its reply, on the next connection if there is none."""
        if self._over is None:
            self.start(envelope, "always")

    def post(self, envelope: dict[str, Any]) -> None:
        """Send a request without waiting for a reply; does nothing without a connection."""
        if self.connected and self._link is not None:
            self._link.send({**envelope, "id": self.new_id()})

    # -- receiving -----------------------------------------------------------------------------

    def _received(self, message: Message, data: bytes) -> None:
        if message.type == "update":
            subscription = self.subscriptions.get(message.id or "")
            if subscription is not None:
                subscription.take(message)
        elif message.type == "notice":
            self.tell(self._codec.notice(data))
        elif not self.calls.take(message) and message.id is None:
            error = error_of(message)
            if isinstance(error, Unauthenticated):
                self._expelled(error)
            elif error is not None:
                self.tell(Notice(code=error.code, message=error.message, path=message.path))

    def _expelled(self, error: Unauthenticated) -> None:
        if self.settings.persistent and self._link is not None:
            self._link.close()
        else:
            self._end(error)

    def _renew(self) -> None:
        """Send a new token of the same principal, to keep the session."""
        token = self.settings.token
        if callable(token):
            self.post({"type": "hello", "body": {"token": token()}})

    def tell(self, notice: Notice) -> None:
        """Pass a notice to its subscription and to the user's callback."""
        if notice.code == "session_expiring":
            self._renew()
        for id_, subscription in list(self.subscriptions.items()):
            if notice.id in (None, id_):
                subscription.note(notice)
        for listener in list(self.listeners):
            listener(notice)
        safely(self.settings.on_notice, notice)

    def _on_lost(self, link: Carrier) -> None:
        if link is self._link:
            self._greeted = False
            for call in self.calls.every():
                if call.envelope["type"] == "hello":
                    call.fail(ConnectionLost(link.why))
            self._lost.set()


def _for_call(error: RcpError, call: Call) -> RcpError:
    """Copy an error for one call, so that each names its own path."""
    made = type(error)(error.message, path=call.envelope.get("path"), remedy=error.remedy)
    made.__cause__ = error
    return call.unanswered(made)


def _outcome(outcome: Reply | RcpError) -> Reply:
    if isinstance(outcome, RcpError):
        raise outcome
    if (error := error_of(outcome)) is not None:
        raise error
    return outcome
