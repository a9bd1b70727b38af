"""The verb `service/hold`: bring a robot to rest without an e-stop, and latch nothing."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import msgspec

from rcp_kernel.contract.fence import unfenced
from rcp_kernel.errors import DeviceTimeout
from rcp_kernel.model import Resource
from rcp_kernel.safety.ending import end_commands
from rcp_kernel.spi import MotionState, Progress
from rcp_kernel.tree.entry import RobotUnit
from rcp_kernel.wire import NO_BODY

if TYPE_CHECKING:
    from rcp_kernel.safety.deadman import Deadman
    from rcp_kernel.sessions.command import Command, CommandTable
    from rcp_kernel.sessions.session import Session

__all__ = ["Held", "Hold", "hold_resource"]

_WAIT = 30.0  # s for a robot to come to rest


class Held(msgspec.Struct, frozen=True):
    """The state of a robot after a hold."""

    at_rest: bool
    detail: str = ""


def hold_resource(name: str, robot: str | None) -> Resource:
    """Return the resource that every robot with something that moves has."""
    return Resource(
        name=name,
        robot=robot,
        description="Bring the robot to rest and end its commands, without latching an e-stop.",
        output=Held,
        timeout=_WAIT,
    )


class Hold:
    """The work of one hold."""

    def __init__(self, units: list[RobotUnit], commands: CommandTable, deadman: Deadman) -> None:
        self._units, self._commands, self._deadman = units, commands, deadman

    async def run(self, command: Command, session: Session, progress: Progress) -> Held:
        """End the robot's commands, then hold it until rest is measured.

        :raises DeviceTimeout: it was commanded to hold, and still moves.
        """
        progress(fraction=0.0)  # commands end from here on: whatever fails now was not refused
        with ExitStack() as held, unfenced():
            for unit in self._units:
                held.enter_context(unit.bringing_to_rest())
            ending = self._end_commands()
            await self._hold()
            if ending:  # their last messages must not arrive after it
                await asyncio.wait(ending)
                await self._hold()
        states = [unit.motion() or MotionState(True, "not measured") for unit in self._units]
        for unit, state in zip(self._units, states, strict=True):
            if not state.at_rest:
                raise DeviceTimeout(
                    f"{unit.name} received the hold command but is not at rest: {state.detail}",
                    remedy="Use the e-stop.",
                )
        return Held(at_rest=True, detail="; ".join(s.detail for s in states if s.detail))

    def _end_commands(self) -> list[asyncio.Task[Any]]:
        """Cancel what drives the robot; return the work that has not ended yet."""
        moving = [e for unit in self._units for e in unit.entries.values() if e.moves]
        paths = {entry.path for entry in moving}
        return end_commands(
            self._deadman,
            self._commands,
            moving,
            lambda one: one.path in paths,
            "the robot was commanded to hold",
        )

    async def _hold(self) -> None:
        await asyncio.gather(*(unit.hold() for unit in self._units))

    def report(self, *, over: bool) -> Any:
        """Report nothing besides the result."""
        return NO_BODY

    def outline(self, report: Any) -> None:
        """Record the whole result."""
