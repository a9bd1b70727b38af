"""The main loop of the guard: reads the gateway's messages and switches transmitters on and off."""

from __future__ import annotations

import os
import select
import socket
import time
from typing import Any

from rcp_guard.channel import Channel
from rcp_guard.journal import Journal
from rcp_guard.succession import Heirs, claim
from rcp_guard.transmitter import Transmitter
from rcp_guard.watch import Watch

__all__ = ["Guard"]

_ALIVE = 1.0  # s between messages to the gateway that the guard is alive
_JOIN = 0.5  # s for senders to close
_LOUD = {"failed": "warning", "missing": "warning"}


class Guard:
    """Guards one gateway until it is gone."""

    def __init__(self, connection: socket.socket, *, after: float, bound: float) -> None:
        self._channel = Channel(connection)
        self._journal = Journal()
        self._watch = Watch(after, bound, time.monotonic())
        self._transmitters: dict[str, Transmitter] = {}
        self._stopping: frozenset[str] = frozenset()
        self._heirs: Heirs | None = None
        self._parent = os.getppid()
        self._bye = False
        self._alive = float("-inf")

    def end(self, *_: object) -> None:
        """Handle a signal: while the gateway lives, it alone decides when its guard ends."""
        self._watch.end()

    def run(self) -> None:
        """Run until the gateway says goodbye, or is gone and its robots were stopped."""
        wait = 0.0
        while not self._bye and not self._watch.over:
            self._listen(wait)
            wait = self._watch.judge(time.monotonic())
            if self._watch.stopping != self._stopping:
                self._switch()
            if self._watch.lost:
                self._yield()
            self._show()
        for transmitter in self._transmitters.values():
            transmitter.close()
        for transmitter in self._transmitters.values():
            transmitter.join(_JOIN)
        self._journal.close(_JOIN)

    def _listen(self, wait: float) -> None:
        """Read all pending messages before judging."""
        watch, channel = self._watch, self._channel
        if channel.ended:
            time.sleep(min(wait, 0.05))
            return
        select.select([channel], [], [], wait)
        for message in channel.receive():
            if message.get("bye"):
                self._bye = True
                return
            watch.hear(time.monotonic(), message.get("armed"))
            if isinstance(plans := message.get("plans"), dict):
                self._take(plans)
        if channel.ended or os.getppid() != self._parent:
            watch.lose(time.monotonic())

    def _take(self, plans: dict[str, dict[str, Any]]) -> None:
        held = self._transmitters
        for name in [n for n, one in held.items() if plans.get(n) != one.plan]:
            held.pop(name).close()
        for name, plan in plans.items():
            if name in held:
                continue
            try:
                transmitter = Transmitter(name, plan, self._report)
            except (
                AttributeError,
                TypeError,
                ValueError,
            ) as error:  # the others are used all the same
                self._report(name, "missing", f"malformed plan: {error!r}")
                continue
            held[name] = transmitter
            transmitter.start()
            transmitter.switch(on=transmitter.group in self._stopping)

    def _switch(self) -> None:
        before, self._stopping = self._stopping, self._watch.stopping
        for transmitter in self._transmitters.values():
            transmitter.switch(on=transmitter.group in self._stopping)
        event = "stopped" if self._stopping else "released"
        groups, reason = sorted(self._stopping or before), self._watch.reason
        self._channel.send({"event": event, "groups": groups, "reason": reason})
        self._journal.note("error", f"guard_{event}", groups=groups, reason=reason)

    def _yield(self) -> None:
        """Leave plans to the guard of the next gateway, once it has taken them over."""
        held = self._transmitters
        if self._heirs is None:
            self._heirs = Heirs({name: one.plan for name, one in held.items()})
        if not self._watch.may_yield(time.monotonic()):
            return
        for name in self._heirs.taken():
            held.pop(name).close()
            self._journal.note("info", "guard_succeeded", plan=name)
        if not held:
            self._watch.end()

    def _report(self, plan: str, state: str, detail: str) -> None:
        self._channel.send({"event": "sender", "plan": plan, "state": state, "detail": detail})
        if state in _LOUD or self._stopping:
            level = _LOUD.get(state, "info")
            self._journal.note(level, "guard_sender", plan=plan, state=state, detail=detail)

    def _show(self) -> None:
        now = time.monotonic()
        if now - self._alive >= _ALIVE:
            self._alive = now
            self._channel.send({"event": "alive"})
            if self._watch.trusts(now):
                for transmitter in self._transmitters.values():
                    if transmitter.ready:
                        claim(transmitter.plan)
