"""Servo, relay, gripper and parachute: commanded, and seen where the vehicle reports them."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from rcp_kernel.errors import DeviceTimeout, InvalidValue, PreconditionFailed
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.dialect import Dialect
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Payloads"]

_SERVO, _RELAY, _GRIPPER, _PARACHUTE = 183, 181, 211, 208
_GRIP = {"release": 0.0, "grab": 1.0}
_CHUTE = {"disable": 0.0, "enable": 1.0, "release": 2.0}
_OUTPUTS, _RELAYS = "SERVO_OUTPUT_RAW", "RELAY_STATUS"
_REPORTS = 5.0  # Hz
_SEEN = 3.0  # s for telemetry to show what was accepted

Which = Annotated[int, Meta(ge=1, le=16, extra_json_schema={"unit": "1"})]


class ServoPulse(Struct, frozen=True, forbid_unknown_fields=True):
    """An output, and its pulse width."""

    output: Which
    pulse: Annotated[int, Meta(ge=500, le=2500, extra_json_schema={"unit": "us"})]


class RelaySwitch(Struct, frozen=True, forbid_unknown_fields=True):
    """A relay, and whether it is on."""

    relay: Annotated[int, Meta(ge=1, le=16, extra_json_schema={"unit": "1"})]
    """From 1, as in the parameters."""
    on: bool


class GripperCommand(Struct, frozen=True, forbid_unknown_fields=True):
    """What the gripper is to do."""

    do: Literal["grab", "release"]
    gripper: Annotated[int, Meta(ge=1, le=6, extra_json_schema={"unit": "1"})] = 1


class ParachuteCommand(Struct, frozen=True, forbid_unknown_fields=True):
    """What the parachute is to do; a release stops the motors and cannot be taken back."""

    do: Literal["enable", "disable", "release"]
    confirm: bool = False
    """Has to be true for a release."""


class Payloads:
    """The payloads of one vehicle."""

    def __init__(self, vehicle: Vehicle, commands: Commands, intervals: Intervals) -> None:
        self._vehicle, self._commands, self._intervals = vehicle, commands, intervals

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path."""
        return {
            "service/servo": self.servo,
            "service/relay": self.relay,
            "service/gripper": self.gripper,
            "service/parachute": self.parachute,
        }

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            Resource(name="service/servo", moves=True, description="Set an output that flies nothing; completes when the vehicle reports the pulse width.", input=ServoPulse, output=ServoPulse, examples=({"output": 9, "pulse": 1500},), timeout=15, max_age=30.0),
            Resource(name="service/relay", moves=True, description="Switch a relay; completes when the vehicle reports it, if it reports relays.", input=RelaySwitch, output=RelaySwitch, examples=({"relay": 1, "on": True},), timeout=15, max_age=30.0),
            Resource(name="service/gripper", moves=True, description="Open or close a gripper; completes when the vehicle accepts it, because none reports its state.", input=GripperCommand, output=GripperCommand, examples=({"do": "grab"},), timeout=15, max_age=30.0),
            Resource(name="service/parachute", moves=True, description="Enable, disable or release the parachute; a release stops the motors and completes when the vehicle has disarmed.", input=ParachuteCommand, output=m.Armed, examples=({"do": "enable"},), timeout=15, max_age=5.0),
        ]  # fmt: skip

    # Servo, relay, gripper

    async def servo(self, given: ServoPulse, _: Progress) -> ServoPulse:
        """Set an output.

        :raises DeviceTimeout: the vehicle does not report the pulse width.
        """
        params = (float(given.output), float(given.pulse), 0.0, 0.0)
        await self._commands.send(Command(_SERVO, params), "servo")
        field = f"servo{given.output}_raw"
        await self._seen(_OUTPUTS, lambda f: f[field] == given.pulse, "servo")
        return given

    async def relay(self, given: RelaySwitch, _: Progress) -> RelaySwitch:
        """Switch a relay; PX4 and older firmware do not report relays.

        :raises DeviceTimeout: the vehicle reports the other state.
        """
        bit = 1 << (given.relay - 1)
        params = (float(given.relay - 1), float(given.on), 0.0, 0.0)
        await self._commands.send(Command(_RELAY, params), "relay")
        if _reports(self._vehicle.dialect, _RELAYS):
            await self._seen(_RELAYS, lambda f: bool(f["on"] & bit) == given.on, "relay")
        return given

    async def gripper(self, given: GripperCommand, _: Progress) -> GripperCommand:
        """Open or close a gripper."""
        params = (float(given.gripper), _GRIP[given.do], 0.0, 0.0)
        await self._commands.send(Command(_GRIPPER, params), "gripper")
        return given

    async def _seen(self, message: str, holds: Callable[[Any], bool], what: str) -> None:
        """Wait for telemetry to show what was accepted.

        :raises DeviceTimeout: it does not.
        """
        vehicle, since = self._vehicle, time.monotonic()

        def shown() -> bool:
            fresh = vehicle.received_at.get(message, float("-inf")) >= since
            return fresh and holds(vehicle.latest[message].fields())

        release = self._intervals.want(message, _REPORTS)
        try:
            shows = await vehicle.until(shown, _SEEN)
        finally:
            release()
        # One that does not report them at all has accepted, which is all there is to know.
        if not shows and message not in self._intervals.refused:
            raise DeviceTimeout(f"{what}: accepted, but {message} does not show it")

    # Parachute

    async def parachute(self, given: ParachuteCommand, progress: Progress) -> m.Armed:
        """Enable, disable or release the parachute.

        :raises InvalidValue: a release without `confirm`.
        :raises PreconditionFailed: a release on the ground.
        :raises DeviceTimeout: the vehicle was released and has not disarmed.
        """
        vehicle, release = self._vehicle, given.do == "release"
        if release and not given.confirm:
            raise InvalidValue(
                "parachute: a release stops the motors and cannot be taken back",
                remedy="Set `confirm` to release it.",
                details={"pointer": "/confirm"},
            )
        if release and (not vehicle.armed or vehicle.landed is True):
            raise PreconditionFailed(
                "parachute: the vehicle is not flying",
                remedy="On the ground, use action/disarm to stop the motors.",
            )
        await self._commands.send(
            Command(_PARACHUTE, (_CHUTE[given.do], 0.0, 0.0, 0.0)), "parachute"
        )
        if release:
            progress()
            if not await vehicle.until(lambda: not vehicle.armed, _SEEN):
                raise DeviceTimeout("parachute: released, but the vehicle has not disarmed")
        return m.Armed(vehicle.armed, vehicle.mode)


def _reports(dialect: Dialect, message: str) -> bool:
    return message in dialect.by_name
