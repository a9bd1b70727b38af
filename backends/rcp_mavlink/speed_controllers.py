"""What the electronic speed controllers (ESCs) of a vehicle's motors report."""

from __future__ import annotations

import math
import time
from collections.abc import AsyncGenerator, Callable, Iterator
from contextlib import ExitStack, asynccontextmanager
from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_kernel.errors import DeviceTimeout, RcpError
from rcp_kernel.model import Resource
from rcp_mavlink.dialect import Dialect
from rcp_mavlink.flightmodes import Family
from rcp_mavlink.frames import Frame
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.vehicle import Vehicle

__all__ = ["ESCS", "SpeedControllers"]

ESCS = "sensor/escs"
_ARDUPILOT = tuple(f"ESC_TELEMETRY_{first}_TO_{first + 3}" for first in range(1, 33, 4))
_STATUS, _INFO = "ESC_STATUS", "ESC_INFO"
_EACH = 4  # motors a message
_TOLD = 8  # motors of which ESC_INFO tells whether they are there
_RADIANS = math.tau / 60  # rad/s of one revolution per minute
_UNKNOWN = 32767
_RECENT = 2.0  # s after which a controller that is silent is left out


class SpeedController(Struct, frozen=True):
    """One speed controller; what it does not report is null."""

    motor: Annotated[int, Meta(ge=1, extra_json_schema={"unit": "1"})]
    velocity: Annotated[float, Meta(extra_json_schema={"unit": "rad/s"})]
    """Of the motor; most report its amount only."""
    voltage: Annotated[float, Meta(extra_json_schema={"unit": "V"})]
    current: Annotated[float, Meta(extra_json_schema={"unit": "A"})]
    temperature: Annotated[float, Meta(extra_json_schema={"unit": "Cel"})] | None
    consumed: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "A.h"})] | None
    errors: Annotated[int, Meta(ge=0, extra_json_schema={"unit": "1"})] | None
    """Number of errors since boot."""


class SpeedControllers:
    """Those of one vehicle, of which each message tells four."""

    def __init__(
        self,
        vehicle: Vehicle,
        intervals: Intervals,
        publish: Callable[[str, Any], None],
        wait: float,
    ) -> None:
        """Wait so many seconds for a message that was requested."""
        self._vehicle, self._intervals, self._publish = vehicle, intervals, publish
        self._messages = _messages(vehicle.dialect, vehicle.family)
        self.heeded = frozenset(vehicle.dialect.by_name[name].id for name in self._messages)
        """The messages handled here, by number."""
        self._latest: dict[int, tuple[float, SpeedController]] = {}
        """By motor: when it was told."""
        self._infos: dict[int, dict[str, Any]] = {}
        """ESC_INFO of a PX4, by the first motor in it."""
        self._watchers = 0
        self._wait = wait
        self._seen: set[str] = set()

    @staticmethod
    def resources(dialect: Dialect, family: Family) -> list[Resource]:
        """List what it serves."""
        messages = _messages(dialect, family)
        if not messages:
            return []
        return [
            Resource(name=ESCS, description="Speed, voltage, current and temperature of each motor's speed controller that has reported within two seconds.", value=list[SpeedController], native=messages[0], meta={"message": messages[0]}),
        ]  # fmt: skip

    def frame(self, frame: Frame) -> None:
        """Take what four of them report."""
        fields = frame.fields()
        self._seen.add(frame.definition.name)
        match frame.definition.name:
            case "ESC_INFO":
                self._infos[fields["index"]] = fields
                return
            case "ESC_STATUS":
                self._forget(fields["index"])
                found = _px4(fields, self._infos.get(fields["index"]))
            case name:
                found = _ardupilot(fields, _ARDUPILOT.index(name) * _EACH)
        now = time.monotonic()
        self._latest |= {one.motor: (now, one) for one in found}
        if self._watchers:
            self._publish(ESCS, self.value())

    def _forget(self, first: int) -> None:
        for motor in range(first + 1, first + 1 + _EACH):
            self._latest.pop(motor, None)

    def value(self) -> list[SpeedController]:
        """Return those that have reported lately, by motor."""
        end = time.monotonic() - _RECENT
        return [one for _, (at, one) in sorted(self._latest.items()) if at >= end]

    async def read(self) -> list[SpeedController]:
        """Have all of them report now.

        :raises RcpError: the vehicle reports none, for the reason that it gives.
        :raises DeviceTimeout: no report comes.
        """
        since, refusal, known = time.monotonic(), None, self._known
        for name in known or self._messages:
            try:
                await self._intervals.request(name)
            except RcpError as error:
                self._vehicle.check()
                refusal = error
                continue
            came = await self._vehicle.until(lambda name=name: self._came(name, since), self._wait)
            if came and not known:
                break
        if not any(self._came(name, since) for name in self._messages):
            raise refusal or DeviceTimeout("no speed controller has reported")
        return self.value()

    @property
    def _known(self) -> tuple[str, ...]:
        """Those of its messages that it sends: a vehicle has a few of many groups of motors."""
        return tuple(name for name in self._messages if name in self._seen)

    def _came(self, name: str, since: float) -> bool:
        return self._vehicle.received_at.get(name, float("-inf")) >= since

    @asynccontextmanager
    async def watched(self, rate: float) -> AsyncGenerator[None]:
        """Request the reports at a rate while entered."""
        with ExitStack() as wishes:
            for name in self._messages:
                wishes.callback(self._intervals.want(name, rate))
            self._watchers += 1
            try:
                yield
            finally:
                self._watchers -= 1


def _messages(dialect: Dialect, family: Family) -> tuple[str, ...]:
    """Return the messages that a dialect has of a family."""
    names = (_STATUS, _INFO) if family.px4 else _ARDUPILOT
    return tuple(name for name in names if name in dialect.by_name)


def _ardupilot(f: dict[str, Any], first: int) -> Iterator[SpeedController]:
    for one in range(_EACH):
        if not f["count"][one]:  # it has never reported
            continue
        yield SpeedController(
            motor=first + one + 1,
            velocity=f["rpm"][one] * _RADIANS,
            voltage=f["voltage"][one] / 100,
            current=f["current"][one] / 100,
            temperature=float(f["temperature"][one]),
            consumed=f["totalcurrent"][one] / 1000,
            errors=None,
        )


def _px4(f: dict[str, Any], info: dict[str, Any] | None) -> Iterator[SpeedController]:
    for one in range(_EACH):
        at = f["index"] + one
        if info is None:
            there = bool(f["voltage"][one])
        else:  # of those beyond the eighth it does not say whether they are there
            there = at < info["count"] and (at >= _TOLD or bool(info["info"] & (1 << at)))
        if not there:
            continue
        hundredths = _UNKNOWN if info is None else info["temperature"][one]
        yield SpeedController(
            motor=at + 1,
            velocity=f["rpm"][one] * _RADIANS,
            voltage=f["voltage"][one],
            current=f["current"][one],
            temperature=None if hundredths == _UNKNOWN else hundredths / 100,
            consumed=None,
            errors=None if info is None else info["error_count"][one],
        )
