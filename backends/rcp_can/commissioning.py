"""The commissioning of a motor: its identity, and procedures that set it up or measure it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

from rcp_can.axis import Axis
from rcp_can.binding import Part
from rcp_can.motor import abandon, end_own_motion, released, unless_lost
from rcp_can.preconditions import check, check_bus, check_feedback, check_link, ready
from rcp_can.procedure import Procedure
from rcp_can.standstill import rested
from rcp_kernel.errors import AdapterUnavailable, ModeForbids, RcpError
from rcp_kernel.model import Operation, Resource
from rcp_kernel.spi import Progress, check_fence

__all__ = ["CommissioningPart", "procedures_of"]

_IDENTITY = ("vendor", "model", "firmware", "serial")


def procedures_of(axis: Axis) -> Sequence[Procedure]:
    """List the procedures of a motor's drive."""
    return axis.drive.procedures(axis.config.gear, axis.velocity_limit)


class CommissioningPart(Part):
    """The procedures of one motor; while one runs, nothing else commands the motor."""

    def __init__(self, axis: Axis, procedures: list[Procedure]) -> None:
        self._axis = axis
        self._procedures = {f"{each.branch}/{axis.name}/{each.verb}": each for each in procedures}
        self._facts = {f"param/{axis.name}/{fact}": fact for fact in _IDENTITY}

    def resources(self) -> list[Resource]:
        """List the identity of the drive, and the procedures."""
        axis = self._axis
        meta = {"profile": axis.config.profile}
        facts = [
            Resource(
                name=name,
                description=f"The {fact} of motor '{axis.name}', as its drive reports it.",
                value=str,
                operations=Operation.READ,
                meta=meta,
            )
            for name, fact in self._facts.items()
        ]
        return facts + [
            Resource(
                name=name,
                description=f"Motor '{axis.name}': {each.description}",
                input=each.input,
                output=each.output,
                feedback=each.feedback,
                examples=each.examples,
                timeout=each.timeout,
                max_age=1.0 if each.motion != "none" else None,
                outlives=each.motion == "none",
                meta=meta | dict(each.meta),
            )
            for name, each in self._procedures.items()
        ]

    async def read(self, name: str) -> Any:
        """Return a part of the drive's identity.

        :raises AdapterUnavailable: the drive has not reported it.
        """
        if name not in self._facts:
            return await super().read(name)
        found = getattr(self._axis.drive.identity, self._facts[name], None)
        if found is None:
            raise AdapterUnavailable(
                f"motor '{self._axis.name}' has not reported its {self._facts[name]}",
                remedy="Check that it is connected; some drives do not report it over CAN.",
            )
        return found

    def foresee(self, name: str, value: Any) -> None:
        """Refuse what `execute` would refuse now."""
        check_link(self._axis)
        self._check(self._procedures[name], value)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Run a procedure; one that moves the motor ends at rest, however it ends."""
        axis, procedure = self._axis, self._procedures[name]
        await ready(axis)
        await released(axis)
        self._check(procedure, value)
        if procedure.needs == "connected":
            return await procedure.run(value, progress)
        axis.owner = name
        try:
            match procedure.motion:
                case "none":
                    return await procedure.run(value, progress)
                case "set_points":
                    return await unless_lost(axis, procedure.run(value, progress))
                case "own":
                    return await self._run(procedure, value, progress)
        except (asyncio.CancelledError, RcpError) as error:
            if procedure.motion == "set_points":
                await abandon(axis, error)
            elif procedure.motion == "own":
                await end_own_motion(axis, error)
            raise
        finally:
            axis.owner = axis.ended = None
            axis.show()

    async def _run(self, procedure: Procedure, value: Any, progress: Progress) -> Any:
        """Let the drive move by itself; return when it is at rest afterwards."""
        axis = self._axis
        check_fence()
        axis.forget(None)
        axis.end_stop()
        result = await unless_lost(axis, procedure.run(value, progress))
        await rested(axis)
        return result

    def _check(self, procedure: Procedure, value: Any) -> None:
        """Check that a procedure can begin.

        :raises RcpError: it cannot, with the reason.
        """
        axis = self._axis
        if procedure.needs == "connected":
            procedure.check(value)
            return
        if axis.owner is not None:
            raise ModeForbids(
                f"motor '{axis.name}' is driven by {axis.owner}",
                remedy="Cancel that command first.",
            )
        if procedure.needs == "enabled":
            check(axis)
        else:
            check_bus(axis)
            check_feedback(axis)
            self._check_off()
        if not axis.resting:  # drives pause while they store: none of them turns meanwhile
            raise ModeForbids(
                f"motor '{axis.name}' is moving",
                remedy="Bring it to rest first; its `standstill` says what counts as rest.",
            )
        procedure.check(value)

    def _check_off(self) -> None:
        axis = self._axis
        faults = ", ".join(fault.name for fault in axis.status.faults)
        if faults:
            raise ModeForbids(
                f"motor '{axis.name}' has faults: {faults}",
                remedy=f"Execute service/{axis.name}/clear_faults first.",
            )
        if axis.enabling or axis.status.energised is not False:
            state = "being enabled" if axis.enabling else axis.state
            raise ModeForbids(
                f"motor '{axis.name}' is {state}",
                remedy=f"Execute service/{axis.name}/disable first.",
            )
