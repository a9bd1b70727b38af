"""Replies to writes, commands and refusals are held back until their records are committed.

The robot never waits for that. A working store delays a reply by a moment; if the store cannot
write, the reply is held back until its request's deadline and then reports the failure.
"""

from __future__ import annotations

import asyncio
from collections import deque

from rcp_audit.records import FULL
from rcp_kernel.errors import QueueFull
from rcp_kernel.sessions.session import Answer
from rcp_kernel.sessions.substitutes import unrecorded
from rcp_kernel.wire import Reply
from rcp_store.ledger import Ledger

__all__ = ["DelayedReplies"]

_LOOK = 0.25  # s between checks for replies past their deadline
_LONGEST = 5.0  # s, maximum delay of a reply
_ESTOP = 0.25  # s, maximum delay of the reply to an e-stop, which is always sent


class _Delayed:
    """A reply waiting for its record."""

    __slots__ = ("anyway", "reply", "send", "until")

    def __init__(self, reply: Reply, send: Answer, until: float, *, anyway: bool) -> None:
        self.reply: Reply | None = reply
        self.send = send
        self.until = until
        self.anyway = anyway

    def release(self) -> None:
        reply, self.reply = self.reply, None
        if reply is not None:
            self.send(reply)

    def give_up(self) -> None:
        """Reply without a record and report this; replies that are not final are dropped."""
        reply = self.reply
        if reply is None:
            return
        if self.anyway:
            reply.message = f"{reply.message or ''} The audit record is not written yet.".lstrip()
            self.release()
            return
        self.reply = None
        if reply.final:
            self.send(unrecorded(reply))


class DelayedReplies:
    """Holds replies back until their records are committed: the `Durability` of the log."""

    def __init__(self, ledger: Ledger, loop: asyncio.AbstractEventLoop) -> None:
        self._ledger = ledger
        self._loop = loop
        self._delayed: deque[_Delayed] = deque()
        self._watching = False

    def check(self) -> None:
        """Check that the log can be written.

        :raises QueueFull: the store fails, or too many records are pending.
        """
        ledger = self._ledger
        if ledger.behind(FULL):
            raise QueueFull(
                f"cannot write the audit log ({ledger.trouble or 'the disk is slow'}); commands "
                "and writes are refused until this works again",
                remedy="Ask the operator to free disk space for `[store] path`, or to unlock "
                "the file.",
                retry_after=1.0,
            )

    def send_estop_when_stored(self, send: Answer, reply: Reply) -> None:
        """Send the reply to an e-stop likewise, but after `_ESTOP` seconds at the latest."""
        self.send_when_stored(send, self._loop.time() + _ESTOP, reply, anyway=True)

    def send_when_stored(
        self, send: Answer, until: float, reply: Reply, *, anyway: bool = False
    ) -> None:
        """Send a reply once all records made so far are committed."""
        moment = self._loop.time()
        until = min(max(until, moment + _LOOK), moment + _LONGEST)
        delayed = _Delayed(reply, send, until, anyway=anyway)
        self._ledger.settled(delayed.release)  # called at once if all are committed
        if delayed.reply is None:
            return
        while self._delayed and self._delayed[0].reply is None:  # released in order: few are kept
            self._delayed.popleft()
        self._delayed.append(delayed)
        if not self._watching:
            self._watching = True
            self._loop.call_later(_LOOK, self._look)

    def _look(self) -> None:
        moment = self._loop.time() + _LOOK
        kept = [delayed for delayed in self._delayed if delayed.reply is not None]
        for delayed in kept:
            if delayed.until < moment:
                delayed.give_up()
        self._delayed = deque(delayed for delayed in kept if delayed.reply is not None)
        self._watching = bool(self._delayed)
        if self._watching:
            self._loop.call_later(_LOOK, self._look)
