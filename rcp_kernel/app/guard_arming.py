"""Arming of the guard, and detection of a blocked event loop."""

from __future__ import annotations

import asyncio
import os
import time

from rcp_kernel.app.guard_process import GuardProcess
from rcp_kernel.app.supervisor import BackendSupervisor
from rcp_kernel.config.safety import Safety
from rcp_kernel.errors import StaleCommand
from rcp_kernel.tree.entry import Entry

__all__ = ["GuardArming"]

_PERIOD = 0.1  # s between two heartbeats at most; a fifth of `guard_after` if that is less
_THAW = 0.5  # s after a freeze during which received requests may be old


class GuardArming:
    """Arms the guard before anything moves, and refuses requests that a freeze has delayed."""

    def __init__(self, loop: asyncio.AbstractEventLoop, safety: Safety) -> None:
        self._loop = loop
        self.on = safety.guard and os.name == "posix"
        self.after = safety.guard_after
        self.period = min(_PERIOD, safety.guard_after / 5)
        """Seconds between two heartbeats."""
        self.process = GuardProcess(loop, safety)
        self.moved: dict[BackendSupervisor, float] = {}
        """When an armed backend last received a command."""
        self.armed: frozenset[str] = frozenset()
        self.expected = float("inf")
        """When the next heartbeat is due, by the loop's clock."""
        self._thawed = float("-inf")
        self._frozen: frozenset[str] = frozenset()
        """The backends that were armed when the loop last stood still."""

    def arm(self, entry: Entry) -> None:
        """Arm the guard before something moves; does next to nothing where it is armed."""
        supervisor = entry.owner
        if not entry.barred or not isinstance(supervisor, BackendSupervisor):
            return
        self.moved[supervisor] = self._loop.time()
        if supervisor.name not in self.armed:
            self.armed |= {supervisor.name}
            self.process.arm(self.armed)

    def check_thaw(self, entry: Entry) -> None:
        """Refuse motion of a robot that the guard has stopped while requests were queued.

        The loop may read these requests before it is notified of the guard's stop.

        :raises StaleCommand: the event loop was blocked until just now.
        """
        supervisor = entry.owner
        if (
            not self.on
            or not entry.barred
            or not isinstance(supervisor, BackendSupervisor)
            or not supervisor.plans
        ):
            return
        self.look_for_freeze()
        left = self._thawed + _THAW - time.monotonic()
        if left > 0 and supervisor.name in self._frozen:
            raise StaleCommand(
                "the gateway froze and the guard stopped the robot; this command may be from "
                "before",
                path=entry.path,
                remedy="Check the robot, then send a new command.",
            )

    def look_for_freeze(self) -> None:
        """Detect a heartbeat later than the guard allows."""
        now = time.monotonic()
        if now - self.expected > self.after and now > self._thawed + _THAW:
            self._thawed, self._frozen = now, self.armed
