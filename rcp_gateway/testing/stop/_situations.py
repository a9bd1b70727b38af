"""The situations in which a robot is stopped, and the faults injected: one class each."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec
import pytest

from rcp_gateway.testing._client import Message
from rcp_gateway.testing._serve import OPERATOR
from rcp_gateway.testing._suite import eventually
from rcp_gateway.testing.backend._base import Robot
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend, Host, MotionState
from rcp_kernel.types import quantity

if TYPE_CHECKING:
    from rcp_gateway.testing.stop._rig import StopRig

__all__ = ["PARTNER", "SITUATIONS", "Situation"]

_STREAM = 0.02  # s between two velocities of a client that drives
_IN_VAIN = 1.0  # s for an answer that can only be that the robot is not confirmed
_NOTICED = 5.0  # s in which a cut link or a frozen device is noticed


class Situation:
    """Nothing is running, and nothing fails."""

    needs: ClassVar[tuple[str, ...]] = ()
    """Faults that the author has to give."""
    partner: ClassVar[bool] = False
    """Whether a second backend fronts the same robot."""
    store: ClassVar[bool] = False
    """Whether the gateway keeps a store."""
    deadline: ClassVar[float | None] = None
    """Time in s to wait for the reply to the stop; short if none can come."""
    shoves: ClassVar[bool] = False
    """Whether a foreign commander continues to move it, so that it can only be stopped
    repeatedly."""

    def __init__(self, rig: StopRig, robot: Robot) -> None:
        self.rig, self.robot = rig, robot

    @classmethod
    def check(cls, rig: StopRig) -> None:
        """Skip the situation if the author cannot bring it about."""
        missing = [name for name in cls.needs if not rig.gives(name)]
        if missing:
            pytest.skip(f"{', '.join(missing)} not given")
        rig.beside = (PARTNER,) if cls.partner else ()

    @classmethod
    @asynccontextmanager
    async def around(cls, rig: StopRig, robot: Robot) -> AsyncGenerator[Situation]:
        """Bring the situation about while entered."""
        case = cls(rig, robot)
        task = asyncio.create_task(case.go_on())
        try:
            await case.begin()
            yield case
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    async def go_on(self) -> None:
        """Do what others do all the time, until cancelled."""

    async def begin(self) -> None:
        """Bring it about."""

    async def during(self) -> None:
        """Do something when the stop is requested and not answered."""

    async def after(self, reply: Message) -> None:
        """Check the reply, and do what follows it."""
        assert reply["status"] == "completed", reply

    async def end(self) -> None:
        """Repair what is still broken."""


class VelocityStream(Situation):
    """A client drives it by a stream of velocities, and does not stop to."""

    async def go_on(self) -> None:
        """Write continuously, whatever the replies."""
        client = self.robot.served.client(OPERATOR)
        resource = next((r for r in self.rig.moving() if r.safe is not None), None)
        while resource is not None:
            body = self.rig.unsafe(resource)
            await client.request("write", self.robot.path(resource.name), body=body)
            await asyncio.sleep(_STREAM)

    async def begin(self) -> None:
        """Wait until it moves."""
        if all(resource.safe is None for resource in self.rig.moving()):
            pytest.skip("it has no velocity")
        await _moves(self.rig)


class Action(Situation):
    """An action runs."""

    async def begin(self) -> None:
        """Set it in motion."""
        self.command = await self.rig.set_in_motion()
        await _moves(self.rig)

    async def after(self, reply: Message) -> None:
        """See that the action ended, and not well."""
        await super().after(reply)
        if self.command is not None:
            final = await self.robot.client.final(self.command)
            assert final["status"] != "completed", final


class Plan(Situation):
    """A plan is running, with steps to come."""

    async def begin(self) -> None:
        """Send a plan that does the same action again and again."""
        names = self.rig.actions()
        if not names:
            pytest.skip("it has no action")
        name, goal = names[0], self.rig.goals()[names[0]]
        await self.rig.prepare(name)
        step = {"do": "execute", "path": self.robot.path(name), "value": goal.lasting}
        self.plan = await self.robot.client.send(
            type="execute", path="/system/plans", body={"steps": [step, step]}
        )
        await _moves(self.rig)

    async def after(self, reply: Message) -> None:
        """See that the plan ended, and not well."""
        await super().after(reply)
        final = await self.robot.client.final(self.plan)
        assert final["status"] != "completed", final


class SecondClient(VelocityStream):
    """One client drives, another sends an action just when the stop is requested."""

    async def during(self) -> None:
        """Send it from elsewhere."""
        other = self.rig.admin()
        for name in self.rig.actions():
            await other.send(
                type="execute", path=self.robot.path(name), body=self.rig.goals()[name].good
            )


class ForeignCommander(Situation):
    """Somebody past the gateway commands it, all the time."""

    needs = ("foreign_commander",)
    shoves = True

    @classmethod
    @asynccontextmanager
    async def around(cls, rig: StopRig, robot: Robot) -> AsyncGenerator[Situation]:
        """Let it be commanded while entered."""
        async with rig.foreign_commander(), super().around(rig, robot) as case:
            await _moves(rig)
            yield case

    async def after(self, reply: Message) -> None:
        """Either it was at rest when that was said, or it was not said."""


class Cut(Situation):
    """The link is cut, at some time, while it moves."""

    needs = ("break_link", "mend_link")

    async def begin(self) -> None:
        """Set it in motion."""
        with suppress(AssertionError):  # its command may end with the link
            await self.rig.set_in_motion()
        await _moves(self.rig)

    async def _noticed(self) -> None:
        backend = self.robot.backend

        async def unknown() -> bool:
            state = backend.motion(None)
            return state is not None and state.at_rest is None

        await eventually(unknown, "the lost link is noticed", _NOTICED)


class CutBefore(Cut):
    """The link is cut before the stop; the answer must not be that it is at rest."""

    deadline = _IN_VAIN

    async def begin(self) -> None:
        """Cut it in motion."""
        await super().begin()
        await self.rig.break_link()
        await self._noticed()

    async def after(self, reply: Message) -> None:
        """See that nothing was promised; then mend the link, and the stop must follow."""
        assert reply["status"] == "failed", reply
        await self.rig.mend_link()


class CutDuring(Cut):
    """The link is cut between the request and the answer."""

    async def during(self) -> None:
        """Cut it."""
        await self.rig.break_link()

    async def after(self, reply: Message) -> None:
        """Mend the link, and the stop must follow."""
        await self.rig.mend_link()


class CutAfter(Cut):
    """The link is cut after the stop was confirmed, and is restored."""

    async def after(self, reply: Message) -> None:
        """Cut it and mend it."""
        await super().after(reply)
        await self.rig.break_link()
        await self._noticed()
        await self.rig.mend_link()


class DeviceFrozen(Cut):
    """The device freezes with its motors turning, and continues later."""

    needs = ("freeze_device", "thaw_device")
    deadline = _IN_VAIN

    async def begin(self) -> None:
        """Freeze it in motion."""
        await super().begin()
        await self.rig.freeze_device()

    async def after(self, reply: Message) -> None:
        """Check that nothing was promised; then let it continue, and expect the stop."""
        assert reply["status"] == "failed", reply
        await self.rig.thaw_device()


class FeedbackFrozen(Cut):
    """The measurement of its motion has stopped; the link is intact."""

    needs = ("freeze_feedback", "thaw_feedback")
    deadline = _IN_VAIN

    async def begin(self) -> None:
        """Freeze it in motion."""
        await super().begin()
        await self.rig.freeze_feedback()
        await self._noticed()

    async def after(self, reply: Message) -> None:
        """See that nothing was promised, and that it was stopped all the same."""
        assert reply["status"] == "failed", reply
        await eventually(self.rig.at_rest, "stopped blindly", self.rig.cancel_within)
        await self.rig.thaw_feedback()


class StoreLost(Action):
    """The store is taken away while the stop is latched."""

    store = True

    async def after(self, reply: Message) -> None:
        """Delete its files."""
        await super().after(reply)
        assert self.rig.store is not None
        for file in self.rig.store.parent.glob(self.rig.store.name + "*"):
            file.unlink(missing_ok=True)


class TwoBackends(Action):
    """A second backend fronts the same robot: a stop of either holds both."""

    partner = True

    async def after(self, reply: Message) -> None:
        """Try to move the other part, and see that it was halted too."""
        await super().after(reply)
        write = await self.rig.admin().request("write", self.robot.path(PARTNERS_DRIVE), body=1.0)
        assert write["error"]["code"] == "estop_active", write
        partner = next(
            life.backend for life in self.robot.served.lives if life.kind == PARTNER.name
        )
        assert isinstance(partner, Partner)
        assert partner.halts >= 1
        assert partner.speed == 0.0


class PartnerStopped(TwoBackends):
    """The second backend's e-stop is requested elsewhere, just before."""

    async def begin(self) -> None:
        """Stop the robot by its other backend's name."""
        await super().begin()
        stop = await self.rig.admin().request(
            "execute", "/system/estop", body={"scope": PARTNER.name}
        )
        assert stop["status"] == "completed", stop
        assert await self.rig.at_rest()


PARTNERS_DRIVE = "actuator/partner_drive"


class NoOptions(msgspec.Struct, frozen=True):
    """Nothing to configure."""


class Partner(BaseBackend):
    """A second backend of the robot: one more motor."""

    def __init__(self) -> None:
        self.speed = 1.0
        self.halts = 0

    async def write(self, name: str, value: Any) -> None:
        """Turn the motor."""
        self.speed = value

    async def halt(self) -> None:
        """Stop it."""
        self.speed = 0.0
        self.halts += 1

    def motion(self, robot: str | None) -> MotionState:
        """Report how fast it turns."""
        return MotionState(at_rest=self.speed == 0.0)


@asynccontextmanager
async def _open_partner(_config: Any, host: Host) -> AsyncGenerator[Partner]:
    host.declare(
        Resource(
            name=PARTNERS_DRIVE,
            description="The speed of one more motor.",
            value=quantity("rad/s"),
            safe=0.0,
        )
    )
    yield Partner()


PARTNER = BackendKind("partner", NoOptions, _open_partner, "One more motor of the same robot.")

SITUATIONS: dict[str, type[Situation]] = {
    "idle": Situation,
    "velocity_stream": VelocityStream,
    "action": Action,
    "plan": Plan,
    "second_client": SecondClient,
    "foreign_commander": ForeignCommander,
    "link_cut_before": CutBefore,
    "link_cut_during": CutDuring,
    "link_cut_after": CutAfter,
    "device_frozen": DeviceFrozen,
    "feedback_frozen": FeedbackFrozen,
    "store_lost": StoreLost,
    "two_backends": TwoBackends,
    "stopped_by_the_other_backend": PartnerStopped,
}


async def _moves(rig: StopRig) -> None:
    async def moving() -> bool:
        return not await rig.at_rest()

    await eventually(moving, "it moves")
