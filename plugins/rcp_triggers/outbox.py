"""The outbox: what is to be delivered, in the store until a target has taken it.

Each target has a worker of its own, which delivers in order, so that none waits for another. A
notice is sent only once it is in the store: an id that a receiver has seen is the same after a
restart.
"""

from __future__ import annotations

import asyncio
import secrets
from collections import deque
from collections.abc import Callable, Mapping
from typing import Literal

import msgspec
import structlog

from rcp_kernel.features import FeatureHost
from rcp_kernel.values import to_plain
from rcp_store.plugin_store import PluginStore
from rcp_triggers.notice import Delivery, Notice, NoticeType
from rcp_triggers.senders import Failed, Refused, Sender

__all__ = ["Outbox", "stored"]

log = structlog.get_logger("rcp.triggers")
_FIRST, _LONGEST = 1.0, 60.0  # s between attempts
_STORED = 1.0  # s to wait for the store: a broken one must not silence alarms
Result = Literal["delivered", "refused", "expired", "dropped"]


async def stored(store: PluginStore, loop: asyncio.AbstractEventLoop) -> None:
    """Wait until everything so far is in the store, within a bound."""
    done = asyncio.Event()
    store.settled(done.set)
    timer = loop.call_later(_STORED, done.set)
    try:
        await done.wait()
    finally:
        timer.cancel()


class _Queue:
    """What waits for one target."""

    def __init__(self) -> None:
        self.waiting: deque[Delivery] = deque()
        self.sending: str | None = None
        """The id of what is being sent now."""
        self.error: str | None = None
        """Why the last attempt failed."""
        self.counts: dict[Result, int] = {"delivered": 0, "refused": 0, "expired": 0, "dropped": 0}
        self.attempts = 0
        """Attempts that failed since the start."""
        self.worker: asyncio.Task[None] | None = None


class Outbox:
    """All deliveries; for the event loop's thread."""

    def __init__(
        self, host: FeatureHost, *, keep: float, queue: int, changed: Callable[[], None]
    ) -> None:
        self._host = host
        self._store = host.store("outbox")
        self.keep = keep
        self.most = queue
        self._changed = changed
        self._senders: dict[str, Sender] = {}
        self.queues: dict[str, _Queue] = {}
        self._since: dict[str, float] = {}
        """When this run came to know each delivery, by `Clock.monotonic`: the clock may be set at any moment."""
        self._number = 0
        self._open = False

    # -- life ----------------------------------------------------------------------------------

    def load(self) -> None:
        """Take over what an earlier run has not delivered.

        Its time starts again: the clock of the earlier run may have been in 1970.
        """
        found: list[Delivery] = []
        for key, row in self._store.load().items():
            try:
                found.append(msgspec.convert(row, Delivery))
            except msgspec.ValidationError as error:
                log.warning("delivery_unreadable", id=key, error=str(error))
                self._store.put(key, None)
        moment = self._host.clock.monotonic()
        for delivery in sorted(found, key=lambda one: one.number):
            self._number = delivery.number
            self._since[delivery.id] = moment
            self._queue(delivery.target).waiting.append(delivery)

    async def open(self, senders: Mapping[str, Sender]) -> None:
        """Begin to deliver, or go on by other senders."""
        before = set(self._senders.values()) - set(senders.values())
        self._senders, self._open = dict(senders), True
        for sender in before:
            await sender.close()
        for name, queue in self.queues.items():
            if name not in senders:
                self._drop_all(name, queue)
            self._wake(name)

    async def close(self) -> None:
        """End; what waits stays in the store."""
        self._open = False
        workers = [queue.worker for queue in self.queues.values() if queue.worker is not None]
        for worker in workers:
            worker.cancel()
        await asyncio.gather(*workers, return_exceptions=True)
        for sender in self._senders.values():
            await sender.close()

    # -- adding --------------------------------------------------------------------------------

    def add(self, target: str, type_: NoticeType, notice: Notice) -> None:
        """Put a notice for one target in; returns at once."""
        self._number += 1
        delivery = Delivery(
            id=f"msg_{secrets.token_hex(12)}",
            number=self._number,
            target=target,
            type=type_,
            created=self._host.clock.now(),
            notice=notice,
        )
        queue = self._queue(target)
        while len(queue.waiting) >= self.most:
            self._drop_oldest(target, queue)
        queue.waiting.append(delivery)
        self._since[delivery.id] = self._host.clock.monotonic()
        self._store.put(delivery.id, to_plain(delivery))
        self._wake(target)

    def _queue(self, target: str) -> _Queue:
        return self.queues.setdefault(target, _Queue())

    def _wake(self, target: str) -> None:
        queue = self.queues[target]
        if self._open and queue.worker is None and queue.waiting and target in self._senders:
            queue.worker = self._host.loop.create_task(self._work(target, queue))

    # -- delivering ----------------------------------------------------------------------------

    async def _work(self, target: str, queue: _Queue) -> None:
        try:
            while queue.waiting and target in self._senders:
                await stored(self._store, self._host.loop)
                await self._deliver(target, queue, queue.waiting[0])
        except Exception:
            log.exception("outbox_failed", target=target)
        finally:
            queue.worker = queue.sending = None

    async def _deliver(self, target: str, queue: _Queue, delivery: Delivery) -> None:
        """Try until it is delivered, refused, or too old."""
        wait = _FIRST
        while target in self._senders:
            if self._host.clock.monotonic() - self._since[delivery.id] > self.keep:
                self._end(queue, delivery, "expired", queue.error)
                return
            queue.sending = delivery.id
            try:
                await self._senders[target].send(delivery)
            except Refused as error:
                self._end(queue, delivery, "refused", str(error))
                return
            except Failed as error:
                self._failed(queue, delivery, str(error))
            except Exception as error:  # a fault of a sender must not end the worker
                log.exception("sender_failed", target=target)
                self._failed(queue, delivery, type(error).__name__)
            else:
                queue.error = None
                self._end(queue, delivery, "delivered", None)
                return
            queue.sending = None
            await asyncio.sleep(wait)
            wait = min(2 * wait, _LONGEST)
            if delivery not in queue.waiting:  # dropped meanwhile
                return

    def _failed(self, queue: _Queue, delivery: Delivery, reason: str) -> None:
        queue.attempts += 1
        if queue.error is None:
            log.warning("notification_failed", target=delivery.target, reason=reason)
        queue.error = reason
        self._changed()

    # -- ending --------------------------------------------------------------------------------

    def _end(self, queue: _Queue, delivery: Delivery, result: Result, reason: str | None) -> None:
        queue.sending = None
        queue.counts[result] += 1
        self._since.pop(delivery.id, None)
        if delivery in queue.waiting:
            queue.waiting.remove(delivery)
        self._store.put(delivery.id, None)
        if result != "delivered":
            self._tell(delivery, result, reason)
        self._changed()

    def _drop_oldest(self, target: str, queue: _Queue) -> None:
        first = queue.waiting[0]
        being_sent = first.id == queue.sending and len(queue.waiting) > 1
        self._end(queue, queue.waiting[1] if being_sent else first, "dropped", "too many wait")

    def _drop_all(self, target: str, queue: _Queue) -> None:
        for delivery in list(queue.waiting):
            self._end(queue, delivery, "dropped", "the target is no longer configured")

    def _tell(self, delivery: Delivery, result: Result, reason: str | None) -> None:
        notice = delivery.notice
        log.warning("notification_lost", target=delivery.target, result=result, reason=reason)
        self._host.note(
            "notification",
            principal=None,
            tenant=notice.tenant,
            path="/system/triggers",
            outcome=result,
            trigger=notice.trigger,
            firing=notice.firing,
            target=delivery.target,
            message=reason,
        )
