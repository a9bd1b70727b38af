"""One motor turned for a moment on the ground, seen at the outputs; the propellers must be off."""

from __future__ import annotations

import math
import time
from collections.abc import Awaitable, Callable
from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_kernel.errors import DeviceTimeout, PreconditionFailed
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.motion import Motion
from rcp_mavlink.ongoing import Ongoing
from rcp_mavlink.vehicle import Vehicle

__all__ = ["MotorTests"]

_MOTOR_TEST, _ACTUATOR_TEST = 209, 310
_PERCENT = 0.0
_OUTPUTS = "SERVO_OUTPUT_RAW"
_REPORTS = 10.0  # Hz
_CHANGED = 20  # µs by which an output shows that a motor turns
_PATIENCE = 3.0  # s for the outputs to show it
_FIRST = 1.0  # s for the first report of the outputs
_SETTLED = 0.3  # s after a stop for which the outputs prove nothing


class MotorTest(Struct, frozen=True, forbid_unknown_fields=True):
    """The motor, and how fast and how long it turns."""

    motor: Annotated[int, Meta(ge=1, le=12, extra_json_schema={"unit": "1"})]
    """Its number, from 1, in the order of the autopilot's test."""
    throttle: Annotated[float, Meta(gt=0, le=1, extra_json_schema={"unit": "1"})] = 0.1
    seconds: Annotated[float, Meta(ge=0.5, le=3, extra_json_schema={"unit": "s"})] = 1.0


class MotorTested(Struct, frozen=True):
    """What the outputs showed."""

    motor: m.Count
    output: m.Count
    """Number of the output that changed."""
    pulse: Annotated[int, Meta(extra_json_schema={"unit": "us"})]
    """Its pulse width meanwhile."""


class MotorTests:
    """The motors of one vehicle."""

    def __init__(
        self, vehicle: Vehicle, commands: Commands, intervals: Intervals, motion: Motion
    ) -> None:
        self._vehicle, self._intervals = vehicle, intervals
        self.ongoing = Ongoing(vehicle, commands, motion, _OUTPUTS)
        """The test that is commanded and not known to be over."""
        self._until = math.inf
        """When the autopilot has surely ended the test by itself, on the monotonic clock."""

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path."""
        return {"action/motor_test": self.run}

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            Resource(name="action/motor_test", description="Turn one motor for a moment, on the ground and disarmed, without propellers; completes when the outputs have shown it.", input=MotorTest, output=MotorTested, examples=({"motor": 1},), energises=True, timeout=30, max_age=5.0)
        ]  # fmt: skip

    async def run(self, given: MotorTest, progress: Progress) -> MotorTested:
        """Turn a motor.

        :raises PreconditionFailed: the vehicle is armed or in the air, or a motor may still turn.
        :raises DeviceTimeout: no output changed, or it did not go back.
        """
        vehicle = self._vehicle
        self.ongoing.check()
        if vehicle.armed or vehicle.landed is False:
            raise PreconditionFailed(
                f"motor_test: the vehicle is {'armed' if vehicle.armed else 'in the air'}",
                remedy="Land it and disarm it first, and take the propellers off.",
            )
        release = self._intervals.want(_OUTPUTS, _REPORTS)
        try:
            before = await self._first_outputs()
        except BaseException:
            release()
            raise
        self._until = math.inf
        try:
            await self.ongoing.begin(
                self._command(given), "motor_test",
                stop=self._stopping(given.motor),
                is_over=lambda since: self._rests(before, since),
                release=release,
            )  # fmt: skip
            self._until = time.monotonic() + given.seconds + _PATIENCE
            progress()  # it may turn from here on
            output, pulse = await self._turned(before, given.seconds + _PATIENCE)
            await self._turned_off(before, output, given.seconds + _PATIENCE)
        except BaseException as error:
            self._until = min(self._until, time.monotonic() + given.seconds + _PATIENCE)
            await self.ongoing.fail(error)
            raise
        self.ongoing.forget()
        return MotorTested(given.motor, output + 1, pulse)

    def _command(self, given: MotorTest) -> Command:
        if self._vehicle.family.px4:  # the output function of motor 1 is 1
            params = (given.throttle, given.seconds, 0.0, 0.0)
            return Command(_ACTUATOR_TEST, params, x=float(given.motor))
        params = (float(given.motor), _PERCENT, given.throttle * 100, given.seconds)
        return Command(_MOTOR_TEST, params)

    def _stopping(self, motor: int) -> Command:
        if self._vehicle.family.px4:
            return Command(_ACTUATOR_TEST, (math.nan, 0.0, 0.0, 0.0), x=float(motor))
        return Command(_MOTOR_TEST, (float(motor), _PERCENT, 0.0, 0.0))

    # What the outputs show

    def _outputs(self) -> list[int]:
        f = self._vehicle.latest[_OUTPUTS].fields()
        return [f[f"servo{n}_raw"] for n in range(1, 17)]

    def _rests(self, before: list[int], since: float) -> bool:
        """Tell whether the outputs are back, or the time of the test is over."""
        if time.monotonic() > self._until:
            return True
        if self._vehicle.received_at.get(_OUTPUTS, float("-inf")) < since + _SETTLED:
            return False
        return all(n - b < _CHANGED for n, b in zip(self._outputs(), before, strict=True))

    async def _first_outputs(self) -> list[int]:
        since = time.monotonic()
        received = self._vehicle.received_at
        if not await self._vehicle.until(
            lambda: received.get(_OUTPUTS, float("-inf")) >= since, _FIRST
        ):
            raise PreconditionFailed(
                "motor_test: the vehicle does not report its outputs, so the test could not be seen",
                remedy="Check that it sends SERVO_OUTPUT_RAW: see sensor/servos.",
            )
        return self._outputs()

    async def _turned(self, before: list[int], seconds: float) -> tuple[int, int]:
        """Return the output that changed, from 0, and its pulse width."""
        found: list[tuple[int, int]] = []

        def changed() -> bool:
            pairs = enumerate(zip(self._outputs(), before, strict=True))
            found[:] = [(n, now) for n, (now, was) in pairs if now - was >= _CHANGED]
            return bool(found)

        if not await self._vehicle.until(changed, seconds):
            raise DeviceTimeout("motor_test: accepted, but no output changed")
        return found[0]

    async def _turned_off(self, before: list[int], output: int, seconds: float) -> None:
        def off() -> bool:
            back = self._outputs()[output] - before[output] < _CHANGED
            return back and not self._vehicle.armed

        if not await self._vehicle.until(off, seconds):
            raise DeviceTimeout("motor_test: the motor did not stop in time")
