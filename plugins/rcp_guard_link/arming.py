"""Arming of the guard, and detection of a blocked event loop."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Sequence

from rcp_guard_link.process import GuardProcess
from rcp_kernel.config.safety import Safety
from rcp_kernel.errors import StaleCommand
from rcp_kernel.features import Call, Guard, Slot
from rcp_kernel.features.robots import SupervisedBackend
from rcp_kernel.tree.entry import Owner

__all__ = ["GuardArming"]

_PERIOD = 0.1  # s between two heartbeats at most; a fifth of `guard_after` if that is less
_THAW = 0.5  # s of punctual heartbeats after a freeze, during which received requests may be old
_THAW_MOST = 10.0  # s after which they are not, however late the heartbeats are


class GuardArming(Guard):
    """Arms the guard before anything moves, and refuses requests that a freeze has delayed."""

    slot = Slot.LEASE
    """Called for safe values too: written late, one may stop what has begun since."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, safety: Safety, backends: Sequence[SupervisedBackend]
    ) -> None:
        self._loop = loop
        self._backends = backends
        self.on = safety.guard and os.name == "posix"
        self.after = safety.guard_after
        self.period = min(_PERIOD, safety.guard_after / 5)
        """Seconds between two heartbeats."""
        self.process = GuardProcess(loop, safety)
        self.moved: dict[Owner, float] = {}
        """When an armed backend last received a command."""
        self.armed: frozenset[str] = frozenset()
        self.expected = float("inf")
        """When the next heartbeat is due, by the loop's clock."""
        self._thawed = float("-inf")
        """When the last freeze ended, or the last late heartbeat after it was."""
        self._stale_until = float("-inf")
        """When requests count as new again at the latest."""
        self._frozen: frozenset[str] = frozenset()
        """The backends that were armed when the loop last stood still."""

    def admit(self, call: Call) -> None:
        """Refuse motion of a robot that the guard has stopped while requests were queued.

        The loop may read these requests before it is notified of the guard's stop.

        :raises StaleCommand: the event loop was blocked until just now.
        """
        entry = call.entry
        if not entry.barred or not self.process.plans:
            return
        self.look_for_freeze()
        if self._thawed + _THAW > time.monotonic() and self._was_stopped(entry.owner.name):
            raise StaleCommand(
                "the gateway froze and the guard stopped the robot; this command may be from "
                "before",
                path=entry.path,
                remedy="Check the robot, then send a new command.",
            )

    def _was_stopped(self, name: str) -> bool:
        return name in self._frozen and any(
            one.name == name and one.plans for one in self._backends
        )

    def confirm(self, call: Call) -> None:
        """Arm the guard before something moves; does next to nothing where it is armed."""
        entry = call.entry
        if not entry.barred:
            return
        owner = entry.owner
        self.moved[owner] = self._loop.time()
        if owner.name not in self.armed:
            self.armed |= {owner.name}
            self.process.arm(self.armed)

    def look_for_freeze(self) -> None:
        """Detect a heartbeat later than the guard allows.

        A machine that is too busy to catch up at once reads what waited later than within `_THAW`.
        """
        now = time.monotonic()
        late = now - self.expected
        if now > self._thawed + _THAW:
            if late > self.after:
                self._thawed, self._frozen = now, self.armed
                self._stale_until = now + _THAW_MOST
        elif late > self.period and now < self._stale_until:
            self._thawed = now
