"""Mission, fence and rally points at once: written to a plan file, loaded from one."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

from msgspec import Meta, Struct
from msgspec.structs import replace

from rcp_kernel.errors import InvalidValue
from rcp_kernel.model import READS, Resource
from rcp_kernel.spi import Progress
from rcp_mavlink.messages import Item
from rcp_mavlink.plan_files import FORMATS, Fault, PlanFile, parsed
from rcp_mavlink.plans import FENCE, MISSION, RALLY, Plans
from rcp_mavlink.reversal import reversed_on_failure
from rcp_mavlink.vehicle import Vehicle

__all__ = ["PlanTransfer"]

_SHOWN = 3  # faults in the message
_TOLD = 100  # faults in the details
_JUMP = "DO_JUMP"
_NONE = (0.0, 0.0, 0.0)
_EXAMPLE = {
    "text": "QGC WPL 110\n"
    "0\t1\t0\t16\t0\t0\t0\t0\t-35.3632621\t149.1652374\t584\t1\n"
    "1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t10\t1\n"
    "2\t0\t3\t16\t0\t0\t0\t0\t-35.3630\t149.1652\t15\t1\n"
}

Text = Annotated[str, Meta(max_length=1 << 20, extra_json_schema={"format": "multiline"})]
Count = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "1"})]


class PlanFormat(Struct, frozen=True, forbid_unknown_fields=True):
    """The kind of file."""

    format: Literal["plan", "waypoints"] = "plan"
    """`plan` of QGroundControl; `waypoints` of Mission Planner, with the mission alone."""


class GivenPlan(Struct, frozen=True, forbid_unknown_fields=True):
    """A file of either kind."""

    text: Text


class PlanText(Struct, frozen=True):
    """A file, and how many items it has."""

    text: str
    mission: Count
    fence: Count
    rally: Count


class PlanLoaded(Struct, frozen=True):
    """How many items the vehicle now has; null is what the file did not speak of."""

    mission: Count | None
    fence: Count | None
    rally: Count | None


class PlanTransfer:
    """The plans of one vehicle as a whole."""

    def __init__(self, vehicle: Vehicle, plans: Plans) -> None:
        self._vehicle, self._plans = vehicle, plans

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            Resource(name="service/plan/export", meta=READS, description="Write mission, fence and rally points to a file.", input=PlanFormat | None, output=PlanText, examples=(None, {"format": "waypoints"}), timeout=300),
            Resource(name="action/plan/load", description="Replace mission, fence and rally points by those of a file; if one is refused, all are put back.", input=GivenPlan, output=PlanLoaded, examples=(_EXAMPLE,), timeout=600, max_age=30.0),
        ]  # fmt: skip

    async def export(self, given: PlanFormat | None, _: Progress) -> PlanText:
        """Write what the vehicle has to a file."""
        form = (given or PlanFormat()).format
        mission = self._renumbered(await self._plans.download(MISSION), 1)
        fence, rally = (), ()
        if form == "plan":
            fence, rally = await self._plans.download(FENCE), await self._plans.download(RALLY)
        home = self._vehicle.home or _NONE
        text = FORMATS[form](PlanFile(mission, fence, rally), home, self._plans.names)
        return PlanText(text, len(mission), len(fence), len(rally))

    async def load(self, given: GivenPlan, progress: Progress) -> PlanLoaded:
        """Replace what a file speaks of; put all back if the vehicle refuses a part, or on a cancel.

        :raises InvalidValue: a part of the file cannot be read; nothing is sent.
        :raises DeviceRejected: the vehicle refuses a part.
        """
        plan, faults = await asyncio.to_thread(parsed, given.text, self._plans.names)
        mission = None if plan.mission is None else self._renumbered(plan.mission, -1)
        faults += _unreachable(mission or ())
        _refuse(faults)
        # The mission comes last: its items may lie outside the fence of before.
        wanted = {FENCE: plan.fence, RALLY: plan.rally, MISSION: mission}
        parts = [(kind, items) for kind, items in wanted.items() if items is not None]
        before = {kind: await self._plans.download(kind) for kind, _ in parts}
        touched: list[int] = []
        async with reversed_on_failure(lambda: self._put_back(touched, before)):
            for place, (kind, items) in enumerate(parts):
                touched.append(kind)
                progress(fraction=place / len(parts))
                await self._plans.upload(kind, items)
        counts = {kind: len(items) for kind, items in parts}
        return PlanLoaded(counts.get(MISSION), counts.get(FENCE), counts.get(RALLY))

    def _renumbered(self, items: tuple[Item, ...], by: int) -> tuple[Item, ...]:
        """Shift the targets of jumps: files count home as item 0, but some vehicles do not."""
        if self._plans.has_home(MISSION):
            return items
        return tuple(
            replace(item, params=(item.params[0] + by, *item.params[1:]))
            if item.command == _JUMP and item.params and item.params[0] is not None
            else item
            for item in items
        )

    async def _put_back(self, touched: list[int], before: dict[int, tuple[Item, ...]]) -> str:
        """Upload what was there before; return what has come of it."""
        left: list[str] = []
        for kind in reversed(touched):
            try:
                await self._plans.upload(kind, before[kind])
                same = await self._plans.download(kind) == before[kind]
            except Exception:  # the others are put back all the same
                same = False
            if not same:
                left.append({MISSION: "mission", FENCE: "fence", RALLY: "rally points"}[kind])
        if left:
            return f"could not be put back: {', '.join(left)}"
        return "mission, fence and rally points are those of before"


def _unreachable(mission: Sequence[Item]) -> Iterator[Fault]:
    for place, item in enumerate(mission, 1):
        if item.command == _JUMP and item.params and (item.params[0] or 0) < 0:
            yield Fault(f"mission item {place}", "it jumps to home, which is none of the items")


def _refuse(faults: list[Fault]) -> None:
    """Refuse a file as a whole.

    :raises InvalidValue: there are faults.
    """
    if not faults:
        return
    shown = "; ".join(f"{fault.where}: {fault.reason}" for fault in faults[:_SHOWN])
    more = f"; and {len(faults) - _SHOWN} more" if len(faults) > _SHOWN else ""
    raise InvalidValue(
        shown + more,
        remedy="Mend these items, or export the plan anew.",
        details={"pointer": "/text", "faults": [fault._asdict() for fault in faults[:_TOLD]]},
    )
