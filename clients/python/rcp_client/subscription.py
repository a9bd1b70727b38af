"""A subscription, as an asynchronous iterator.

Sequence numbers ensure continuity: duplicates are dropped, so that a replay after a lost connection
joins seamlessly, and missing samples are reported by a `gap` notice.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncGenerator, Callable, Sequence
from typing import Any, Self

from rcp_client.channel import Channel
from rcp_client.errors import ConnectionLost, safely
from rcp_client.messages import Message, Notice, Reply, Update
from rcp_client.pages import pages
from rcp_client.tries import Tries
from rcp_protocol.errors import (
    BY_CODE,
    AdapterUnavailable,
    DuplicateRequest,
    Overrun,
    RcpError,
    UnknownPath,
)
from rcp_protocol.values import value_type

__all__ = ["Subscription"]

_FILTERS = ("rate", "deadband", "where")
_PAGE = 1000  # paths requested at once


class Subscription:
    """Updates of one or more paths; use `async for` on it, or on `events()` to include notices.

    Best used with `async with`: the subscription then exists for the duration of the block. A bare
    `async for` subscribes at its start and unsubscribes when it is left. It ends by itself after
    `count`
    or `duration`, and otherwise raises the error that ended it.
    """

    def __init__(
        self,
        channel: Channel,
        patterns: Sequence[str],
        options: dict[str, Any],
        *,
        type_: Any = None,
        buffer: int = 4096,
        on_notice: Callable[[Notice], None] | None = None,
    ) -> None:
        self.id = channel.new_id()
        self.patterns = tuple(patterns)
        self.paths: list[str] = []
        """The paths that the patterns matched at the start."""
        self.seen: dict[str, int] = {}
        """Sequence number of the last sample of each path."""
        self.duplicates = 0
        """Number of dropped duplicates."""
        self._channel = channel
        self._options = {key: item for key, item in options.items() if item is not None}
        self._type = None if type_ is None else value_type(type_)
        self._buffer = buffer
        self._on_notice = on_notice
        self._reliable = self._options.get("qos", {}).get("reliability") == "reliable"
        on_change = self._options.get("on") == "change"
        self._whole = self._reliable and not on_change and self._options.keys().isdisjoint(_FILTERS)
        """Whether every sample must arrive, so that a skipped number is a gap."""
        # Counted here: the gateway would count updates that a lost connection swallows.
        self._left: int | None = self._options.pop("count", None)
        self._duration: float | None = self._options.pop("duration", None)
        self._timer: asyncio.TimerHandle | None = None
        self._queue: deque[Update | Notice] = deque()
        self._skipped: dict[str, int] = {}
        self._wake = asyncio.Event()
        self._standing = False
        self._waiting = False
        """Whether a temporary refusal has been reported."""
        self._finished = False
        self._error: RcpError | None = None
        self._renewal: asyncio.Task[None] | None = None

    # -- start and end -------------------------------------------------------------------------

    async def __aenter__(self) -> Self:
        await self._begin()
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()

    async def _begin(self) -> None:
        self._channel.subscriptions[self.id] = self
        try:
            reply = await self._first()
            while reply is None:  # the first values may have been lost with the first reply
                self._drop()
                self.id = self._channel.new_id()
                self._channel.subscriptions[self.id] = self
                reply = await self._subscribe()
        except BaseException:
            self._channel.subscriptions.pop(self.id, None)
            raise
        self._standing = True
        if self._duration is not None:
            self._timer = asyncio.get_running_loop().call_later(self._duration, self.close)
        self.paths = (reply.body or {}).get("paths", [])
        if reply.cursor is not None:
            self.paths = sorted({*self.paths, *await self._rest(reply.cursor)})

    async def _first(self) -> Reply | None:
        """Subscribe for the first time; retries while the robot may still come up."""
        self._waiting = False
        tries = Tries(self._channel.settings.patience)
        while True:
            try:
                return await self._subscribe()
            except ConnectionLost:
                raise
            except AdapterUnavailable as error:
                self._tell_waiting(error)
                if self._finished or not await tries.again(error):
                    raise

    def _tell_waiting(self, error: RcpError) -> None:
        if not self._waiting:
            self._waiting = True
            self._channel.tell(Notice(code="waiting", id=self.id, message=error.message))

    async def _rest(self, cursor: str) -> list[str]:
        """Return the paths that did not fit in the reply."""
        found: list[str] = []
        body = {"op": "subscribe", "limit": _PAGE, "schemas": False, "cursor": cursor}
        for pattern in self.patterns:
            envelope = {"type": "discover", "path": pattern, "body": body}
            async for reply in pages(self._channel.ask, envelope):
                found += [resource["path"] for resource in reply.body["resources"]]
        return found

    async def _subscribe(self) -> Reply | None:
        """Subscribe; None means that the gateway still has the subscription."""
        channel = self._channel
        body = {**self._options, "paths": self.patterns[1:]}
        envelope = {"type": "subscribe", "path": self.patterns[0], "body": body}
        call = channel.start(envelope, "always", id_=self.id)
        try:
            return await channel.finish(call, channel.settings.deadline + 2)
        except DuplicateRequest:
            if len(call.ids) < 2 and not self._standing:
                raise
            return None

    def close(self) -> None:
        """End the subscription; notifies the gateway without waiting."""
        if not self._finished:
            self._drop()
        self._finish()

    def _drop(self) -> None:
        if self._channel.subscriptions.pop(self.id, None) is not None:
            self._channel.later({"type": "unsubscribe", "body": {"subscription": self.id}})

    def fail(self, error: RcpError) -> None:
        """End the subscription with an error, raised after the queued updates."""
        if not self._finished:
            self._error = error
        self._finish()

    def _finish(self) -> None:
        self._finished = True
        self._channel.subscriptions.pop(self.id, None)
        if self._timer is not None:
            self._timer.cancel()
        renewal = self._renewal
        if renewal is not None and renewal is not asyncio.current_task():
            renewal.cancel()
        self._wake.set()

    # -- iterate -------------------------------------------------------------------------------

    def __aiter__(self) -> AsyncGenerator[Update]:
        return self._updates()

    async def _updates(self) -> AsyncGenerator[Update]:
        async for item in self.events():
            if isinstance(item, Update):
                yield item

    async def events(self) -> AsyncGenerator[Update | Notice]:
        """Iterate over updates and notices in the order of arrival.

        :raises RcpError: the error that ended the subscription, if any.
        """
        started_here = not self._standing and not self._finished
        if started_here:
            await self._begin()
        try:
            while True:
                while self._queue:
                    yield self._typed(self._queue.popleft())
                if self._finished:
                    break
                self._wake.clear()
                await self._wake.wait()
        finally:
            if started_here:
                self.close()
        if self._error is not None:
            raise self._error

    def _typed(self, item: Update | Notice) -> Update | Notice:
        if self._type is not None and isinstance(item, Update) and not item.truncated:
            item.body = self._type.convert(item.body)
        return item

    # -- from the channel ----------------------------------------------------------------------

    def take(self, message: Message) -> None:
        """Queue an update; a duplicate is dropped."""
        path, seq = message.path or "", message.seq or 0
        last = self.seen.get(path, 0)
        if seq <= last:
            self.duplicates += 1
            return
        if self._finished:
            return
        if self._whole and last and seq > last + 1:
            self._channel.tell(_gap(self.id, path, last + 1, seq - 1))
        self.seen[path] = seq
        if len(self._queue) >= self._buffer:
            if self._reliable:
                self._overrun(path)
                return
            self._skip()
        self._queue.append(
            Update(
                path=path,
                seq=seq,
                timestamp=message.timestamp or "",
                body=message.body,
                dropped=message.dropped + self._skipped.pop(path, 0),
                native_type=message.native_type,
                truncated=message.truncated,
                size=message.size,
            )
        )
        self._wake.set()
        if self._left is not None:
            self._left -= 1
            if self._left == 0:
                self.close()

    def _skip(self) -> None:
        """Drop the oldest update; the next one reports the number of dropped ones."""
        old = self._queue.popleft()
        if isinstance(old, Update):
            self._skipped[old.path] = self._skipped.get(old.path, 0) + 1 + old.dropped

    def _overrun(self, path: str) -> None:
        self.close()
        self._error = Overrun(
            f"{self._buffer} updates are unread in this client",
            path=path,
            details={"buffer": self._buffer},
        )

    def note(self, notice: Notice) -> None:
        """Queue a notice, and react to it."""
        safely(self._on_notice, notice)
        if len(self._queue) < 2 * self._buffer:
            self._queue.append(notice)
            self._wake.set()
        if notice.id != self.id:
            return
        if notice.code == "gap" and notice.facts.get("reason") == "restart":
            self.seen.clear()  # numbers start again
        elif notice.code == "gap" and notice.path is not None:
            last = notice.facts.get("last", 0)
            self.seen[notice.path] = max(last, self.seen.get(notice.path, 0))
        elif notice.code == "subscription_ended":
            self._finish()
        elif (error := notice.facts.get("error")) is not None:
            class_ = BY_CODE.get(error.get("code"), Overrun)
            facts = {key: error.get(key) for key in ("path", "remedy", "details")}
            self.fail(class_(error.get("message", notice.code), **facts))

    # -- after a lost connection ---------------------------------------------------------------

    def restore(self, *, restarted: bool) -> None:
        """Re-establish the subscription on a new connection."""
        if restarted:  # numbers start again
            self.seen.clear()
        if not self._standing:
            return  # its `subscribe` is pending and will be sent again
        if self._renewal is not None:
            self._renewal.cancel()
        self._renewal = asyncio.create_task(self._renew())

    async def _renew(self) -> None:
        """Subscribe again under the same id; a refusal as duplicate means it still exists."""
        self._waiting = False
        tries = Tries(self._channel.settings.patience)
        while True:
            try:
                reply = await self._subscribe()
                break
            except ConnectionLost:
                return  # repeated with the next connection
            except RcpError as error:
                # After a restart the robot may come up later than the gateway, so that a known path
                # may only appear later.
                hopeful = error.retryable or isinstance(error, UnknownPath)
                if hopeful:
                    self._tell_waiting(error)
                if not hopeful or not await tries.again(error):
                    self.fail(error)
                    return
        if reply is not None:
            self._channel.tell(_gap(self.id, None, None, None))


def _gap(id_: str, path: str | None, first: int | None, last: int | None) -> Notice:
    if first is None or last is None:
        text = "the subscription had to be restarted; samples in between are lost"
        return Notice(code="gap", id=id_, path=path, message=text)
    lost = last - first + 1
    return Notice(
        code="gap",
        id=id_,
        path=path,
        message=f"{lost} samples of {path} were lost",
        facts={"lost": lost, "first": first, "last": last},
    )
