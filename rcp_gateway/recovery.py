"""What a robot is made to do, when it is in reach again, about a command that was lost before."""

from __future__ import annotations

import asyncio
from functools import partial

import structlog

from rcp_kernel.contract.fence import permitted
from rcp_kernel.errors import RcpError
from rcp_kernel.safety.loss import tell_cut_off
from rcp_kernel.safety.safety_events import SafetyEvents
from rcp_kernel.safety.stop import StopController
from rcp_kernel.sessions.command import Command
from rcp_kernel.tree.entry import Entry, Owner, RobotUnit
from rcp_kernel.tree.lost_command import BEFORE
from rcp_requests.journal import CommandJournal

__all__ = ["LossRecovery"]

log = structlog.get_logger("rcp.supervisor")
_FIRST_RETRY = 0.25  # s
_LAST_RETRY = 10.0  # s


class LossRecovery:
    """Stops the latched robots of a backend again, and applies `Backend.on_loss` to the others."""

    def __init__(
        self, owner: Owner, journal: CommandJournal, stops: StopController, events: SafetyEvents
    ) -> None:
        self._owner = owner
        self._journal = journal
        self._stops = stops
        self._events = events
        self._running: dict[RobotUnit, asyncio.Task[None]] = {}
        self._cut_off: list[Command] = []
        """Commands of an earlier gateway whose loss policy has not been reported yet."""

    def find_cut_off(self, entry: Entry) -> None:
        """Record a command that an earlier gateway began and that the robot may still carry out."""
        cut_off = [c for c in self._journal.interrupted if c.path == entry.path]
        if cut_off:
            for command in cut_off:
                self._journal.interrupted.remove(command)
            self._cut_off += cut_off
            self.report_cut_off()
            entry.unit.loss.note(entry.path, BEFORE)
            self.settle(entry.unit)

    def report_cut_off(self) -> None:
        """Add the loss policy to the errors of those commands, once it is known."""
        if self._owner.backend is None:
            return
        for command in self._cut_off:
            tell_cut_off(command, self._owner.on_loss)
            self._journal.keep(command)
        self._cut_off.clear()

    def settle(self, unit: RobotUnit) -> None:
        """Stop a latched robot that is available again; otherwise settle its lost commands."""
        if self._owner.backend is None:
            return
        if unit.latch is not None:
            if unit.latch.shown is None:  # otherwise its own gateway holds it, or has released it
                self._stops.resume(unit)
        elif unit.loss.command is not None and unit not in self._running:
            task = asyncio.create_task(self._recover(unit), name=f"recover {unit.name}")
            self._running[unit] = task
            task.add_done_callback(partial(self._ended, unit))

    def _ended(self, unit: RobotUnit, task: asyncio.Task[None]) -> None:
        self._running.pop(unit, None)
        if not task.cancelled():  # a command may have been lost since the task looked last
            self.settle(unit)

    def cancel(self) -> None:
        """Cancel what is in progress: the backend closes."""
        for recovery in self._running.values():
            recovery.cancel()

    async def _recover(self, unit: RobotUnit) -> None:
        """Apply a robot's policy for a lost command, unless it has a new one."""
        wait = _FIRST_RETRY
        while (lost := unit.loss.command) is not None and (
            backend := self._owner.backend
        ) is not None:
            if unit.latch is not None:  # the stop settles it
                return
            try:
                with permitted(unit, unit.stops):
                    done = await backend.recover(unit.robot)
            except Exception as error:
                unexpected = None if isinstance(error, RcpError) else error
                text = str(error)
                log.warning(
                    "not_recovered",
                    backend=unit.name,
                    command=lost.path,
                    error=text,
                    exc_info=unexpected,
                )
                await asyncio.sleep(wait)
                wait = min(wait * 2, _LAST_RETRY)
            else:
                if unit.loss.command is lost:  # otherwise another was lost meanwhile
                    unit.loss.command = None
                log.warning("recovered", backend=unit.name, command=lost.path, done=done)
                self._events.recovered(unit, lost.path, done)
