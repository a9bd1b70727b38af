"""The services of a robot with several motors: common power switching, and a reset."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any, Protocol

import anyio

from rcp_can.axis import Axis
from rcp_can.binding import Part
from rcp_can.config import CanConfig
from rcp_can.motor import released
from rcp_can.power_switch import enable
from rcp_can.preconditions import check_feedback, check_link, ready
from rcp_can.standstill import rested
from rcp_can.together import all_of, together
from rcp_kernel.errors import AdapterUnavailable, ModeForbids, RcpError
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress, unfenced
from rcp_profiles import claim, offer

__all__ = ["Group", "GroupPowerPart", "group_powers"]

_SERVICE = 10.0  # s
_WITHDRAW = 1.0  # s that switching off again may take


class Group(Protocol):
    """Motors that move together."""

    @property
    def axes(self) -> Sequence[Axis]:
        """The motors."""
        ...

    def settle(self, reason: RcpError) -> None:
        """Bring them to rest; the running command ends with `reason`.

        :raises AdapterUnavailable: one of them cannot be reached; the others are brought to rest.
        """
        ...

    def reset(self) -> None:
        """Reset counters, and restore the initial parameters."""
        ...


class GroupPowerPart(Part):
    """The services of a robot: its power stages together, and `reset_system`."""

    def __init__(self, place: str | None, groups: Sequence[Group]) -> None:
        self._place, self._groups = place, groups
        self._axes = list(dict.fromkeys(axis for group in groups for axis in group.axes))

    def resources(self) -> list[Resource]:
        """Claim the profile `power`."""
        motors = ", ".join(axis.name for axis in self._axes)
        return claim(
            ["power"],
            offer("service/reset_system", timeout=_SERVICE),
            offer(
                "service/enable",
                description=f"Switch the power stages of {motors} on, without moving: all or none.",
                timeout=_SERVICE,
            ),
            offer(
                "service/disable",
                description=f"Switch the power stages of {motors} off.",
                timeout=_SERVICE,
            ),
            Resource(
                name="service/clear_faults",
                description=f"Clear the faults of {motors}; the power stages are not switched.",
                timeout=_SERVICE,
            ),
            place=self._place,
        )

    async def execute(self, name: str, value: Any, progress: Progress) -> None:
        """Switch all motors, or reset."""
        verb = name.rpartition("/")[2]
        if verb == "reset_system":
            await self._reset()
        else:
            await _switch(verb, self._axes)

    async def _reset(self) -> None:
        """Bring all motors to rest, and clear their faults.

        :raises RcpError: a motor cannot be reached, so nobody knows whether it is at rest.
        """
        for group in self._groups:
            with suppress(AdapterUnavailable):  # checked at the end
                group.settle(ModeForbids("a reset ended the move"))
        await together(rested(axis) for axis in self._axes if axis.online and axis.blind is None)
        await together(axis.clear_faults() for axis in self._axes)
        for group in self._groups:
            group.reset()
        for axis in self._axes:
            if axis.met or not axis.config.optional:
                check_link(axis)
                check_feedback(axis)


def group_powers(
    config: CanConfig, drives: Sequence[Group], joints: Sequence[Group]
) -> list[GroupPowerPart]:
    """Create the services of each group; groups that are the same robot share one set."""
    tables = (*config.diff_drives.items(), *config.joint_groups.items())
    named = list(zip(tables, (*drives, *joints), strict=True))
    found = [GroupPowerPart(name, [group]) for (name, table), group in named if not table.as_robot]
    robot = [group for (_, table), group in named if table.as_robot]
    return [*found, GroupPowerPart(None, robot)] if robot else found


async def _switch(verb: str, axes: Sequence[Axis]) -> None:
    """Enable, disable or clear the faults of all motors.

    :raises RcpError: one of them fails; after `enable`, no motor is on that was not on before.
    """
    if verb == "disable":
        await all_of(axis.disable() for axis in axes)  # one that fails leaves no other on
        return
    for axis in axes:
        await ready(axis)
        await released(axis)
    if verb == "clear_faults":
        await together(axis.clear_faults() for axis in axes)
        return
    for axis in axes:
        if axis.owner is not None:
            raise ModeForbids(f"motor '{axis.name}' is driven by {axis.owner}")
    await _enable([axis for axis in axes if not axis.status.enabled])


async def _enable(axes: Sequence[Axis]) -> None:
    try:
        await together(enable(axis) for axis in axes)
    except BaseException:
        await _withdraw(axis for axis in axes if axis.wanted_on)
        raise


async def _withdraw(axes: Iterable[Axis]) -> None:
    """Switch the motors of an incomplete group off again."""
    with unfenced(), suppress(RcpError), anyio.move_on_after(_WITHDRAW, shield=True):
        await all_of(axis.disable() for axis in axes)
