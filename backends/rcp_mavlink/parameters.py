"""Parameters: all of them listed once, then followed; written until the vehicle says the value back."""

from __future__ import annotations

import asyncio
import difflib
import math
import struct
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from rcp_kernel.errors import DeviceRejected, DeviceTimeout, OutOfRange, UnknownPath
from rcp_mavlink.frames import Frame
from rcp_mavlink.hub import Hub
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Parameter", "Parameters", "bounds"]

_QUIET = 0.7  # s without a value, after which those that are missing are asked for
_ROUNDS = 8
_AT_ONCE = 50
_REAL = 9
_CODES = {1: "B", 2: "b", 3: "H", 4: "h", 5: "I", 6: "i", 9: "f"}
_BITS = {1: (0, 255), 2: (-128, 127), 3: (0, 65535), 4: (-32768, 32767), 5: (0, 2**32 - 1), 6: (-(2**31), 2**31 - 1)}  # fmt: skip


class Parameter(NamedTuple):
    """One parameter as the vehicle said it last."""

    value: float
    type: int
    """MAV_PARAM_TYPE."""
    place: int


def bounds(type_: int) -> tuple[int, int] | None:
    """Return what an integer type holds; None for a real number."""
    return _BITS.get(type_)


class Parameters:
    """The parameters of one vehicle; `told` is called with each name whose value came."""

    def __init__(self, hub: Hub, vehicle: Vehicle, told: Callable[[str], None]) -> None:
        self._hub, self._vehicle, self._told = hub, vehicle, told
        self.known: dict[str, Parameter] = {}
        self.count: int | None = None
        self._last = 0.0
        self.complete = asyncio.Event()

    def take(self, frame: Frame) -> None:
        """Take PARAM_VALUE."""
        fields = frame.fields()
        name = fields["param_id"].split(b"\0", 1)[0].decode("ascii", "replace")
        type_, place = fields["param_type"], fields["param_index"]
        value = self._decoded(fields["param_value"], type_)
        self._last = time.monotonic()
        before = self.known.get(name)
        if place == 0xFFFF and before is not None:
            place = before.place
        self.known[name] = Parameter(value, type_, place)
        self.count = fields["param_count"] or self.count
        if self.count is not None and len(self.known) >= self.count:
            self.complete.set()
        self._told(name)

    async def list(self) -> None:
        """Have the vehicle say all of them, and again those that are lost on the way."""
        vehicle, module = self._vehicle, self._hub.dialect.module
        to = (vehicle.system, vehicle.component)
        self._hub.send(vehicle, module.MAVLink_param_request_list_message(*to))
        for _ in range(_ROUNDS):
            self._last = time.monotonic()
            while time.monotonic() - self._last < _QUIET:
                try:
                    async with asyncio.timeout(_QUIET):
                        await self.complete.wait()
                except TimeoutError:
                    continue
                return
            if self.count is None:
                self._hub.send(vehicle, module.MAVLink_param_request_list_message(*to))
                continue
            there = {parameter.place for parameter in self.known.values()}
            missing = [place for place in range(self.count) if place not in there]
            for place in missing[:_AT_ONCE]:
                self._hub.send(vehicle, module.MAVLink_param_request_read_message(*to, b"", place))

    async def read(self, name: str) -> float:
        """Ask for a value.

        :raises UnknownPath: the vehicle has no such parameter, which it says by silence.
        """
        module, vehicle = self._hub.dialect.module, self._vehicle
        message = module.MAVLink_param_request_read_message(
            vehicle.system, vehicle.component, name.encode(), -1
        )
        value = await self._exchange(name, message)
        if value is not None:
            return value
        if name in self.known:
            raise DeviceTimeout(f"the vehicle did not say {name}")
        near = difflib.get_close_matches(name.upper(), self.known, 3, 0.6)
        remedy = f"Did you mean {' or '.join(near)}?" if near else "param/* lists those it has."
        raise UnknownPath(f"the vehicle has no parameter {name}", remedy=remedy)

    async def write(self, name: str, value: float) -> float:
        """Bring a value into force; return what is in force then.

        :raises DeviceRejected: the vehicle kept the old one.
        """
        module, vehicle = self._hub.dialect.module, self._vehicle
        before = self.known[name]
        limits = bounds(before.type)
        if limits is not None and not limits[0] <= value <= limits[1]:
            raise OutOfRange(f"{name} holds {limits[0]} to {limits[1]}, not {value:g}")
        message = module.MAVLink_param_set_message(
            vehicle.system,
            vehicle.component,
            name.encode(),
            self._encoded(value, before.type),
            before.type,
        )
        now = await self._exchange(name, message)
        if now is None:
            raise DeviceTimeout(f"the vehicle did not confirm {name}")
        wanted = self._decoded(self._encoded(value, before.type), before.type)
        if now != wanted and now == before.value:
            said = self._vehicle.texts_since(time.monotonic() - 1.0)
            raise DeviceRejected(f"the vehicle keeps {name} at {now:g}", details={"texts": said})
        return now

    async def _exchange(self, name: str, message: Any) -> float | None:
        self._vehicle.check()
        heard = asyncio.Event()

        def take(frame: Frame) -> None:
            if frame.fields()["param_id"].split(b"\0", 1)[0] == name.encode():
                heard.set()

        config = self._hub.config
        with self._vehicle.listening("PARAM_VALUE", take):
            for _ in range(config.retries + 1):
                self._hub.send(self._vehicle, message)
                try:
                    async with asyncio.timeout(config.timeout):
                        await heard.wait()
                except TimeoutError:
                    self._vehicle.check()
                    continue
                return self.known[name].value
        return None

    def _encoded(self, value: float, type_: int) -> float:
        """Return the float that stands for a value: PX4 puts the bits of integers in it."""
        if type_ == _REAL:
            return value
        if not self._vehicle.family.px4:
            return float(round(value))
        code = _CODES.get(type_, "i")
        return struct.unpack("<f", struct.pack(f"<{code}", round(value)).ljust(4, b"\0"))[0]

    def _decoded(self, value: float, type_: int) -> float:
        if type_ == _REAL:
            return struct.unpack("<f", struct.pack("<f", value))[0]
        if self._vehicle.family.px4:
            code = _CODES.get(type_, "i")
            size = struct.calcsize(code)
            return float(struct.unpack(f"<{code}", struct.pack("<f", value)[:size])[0])
        return float(round(value)) if math.isfinite(value) else value
