"""Parameters: listed once, then tracked; written until the vehicle reports the value back."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, NamedTuple

from rcp_kernel.errors import DeviceRejected, DeviceTimeout, OutOfRange, RcpError, UnknownPath
from rcp_mavlink.frames import Frame
from rcp_mavlink.hub import Hub
from rcp_mavlink.paramcoding import REAL, bounds, decoded, param_set
from rcp_mavlink.parameter_hazards import check_sent
from rcp_mavlink.vehicle import Vehicle
from rcp_protocol.similarity import nearest
from rcp_protocol.timeouts import timeout

__all__ = ["Parameter", "Parameters"]

_QUIET = 0.7  # s without a value until missing ones are requested
_ROUNDS = 8
_AT_ONCE = 50
_NOT_THERE = 1
_LARGEST = 3.4e38  # of a REAL32
_HASH = "_HASH_CHECK"
"""What PX4 sends in front of its list: a checksum of it, which is no parameter."""
_UNLISTED = 0xFFFF
"""The index of a value that is sent outside a list."""
_ERRORS = {
    2: "out of range", 3: "not permitted", 4: "no such component", 5: "read-only",
    6: "unknown type", 7: "wrong type", 8: "cannot be read",
}  # fmt: skip


class Parameter(NamedTuple):
    """One parameter as last reported by the vehicle."""

    value: float
    type: int
    """MAV_PARAM_TYPE."""
    place: int


class Parameters:
    """The parameters of one vehicle; `on_value` is called with the name of each value received."""

    def __init__(self, hub: Hub, vehicle: Vehicle, on_value: Callable[[str], None]) -> None:
        self._hub, self._vehicle, self._on_value = hub, vehicle, on_value
        self.known: dict[str, Parameter] = {}
        self.count: int | None = None
        self._last = float("-inf")
        self._listed: set[int] = set()
        """Places that were received of the list."""
        self._doubtful: set[str] = set()
        """Those of the list before, until they come again."""
        self.complete = asyncio.Event()
        self._turn = asyncio.Lock()

    def take(self, frame: Frame) -> None:
        """Handle PARAM_VALUE."""
        fields = frame.fields()
        name = fields["param_id"].split(b"\0", 1)[0].decode("ascii", "replace")
        type_, place = fields["param_type"], fields["param_index"]
        value = self._decoded(frame, type_)
        self._last = time.monotonic()
        if name == _HASH:
            return
        before = self.known.get(name)
        if place == _UNLISTED and before is not None:
            place, type_ = before.place, _kept_type(before.type, type_, value)
        elif place != _UNLISTED:
            self._listed.add(place)
        self.known[name] = Parameter(value, type_, place)
        self._doubtful.discard(name)
        count = fields["param_count"] or self.count
        if count != self.count and not self.complete.is_set():
            self._listed &= {place}  # the others may have moved
        self.count = count
        if count is not None and self._listed.issuperset(range(count)):
            for gone in self._doubtful:
                del self.known[gone]
            self._doubtful.clear()
            self.complete.set()
        self._on_value(name)

    def forget(self) -> None:
        """Expect a new list: the vehicle may have other parameters, or other values."""
        self._listed.clear()
        self._doubtful = set(self.known)
        self.complete.clear()

    async def list(self) -> None:
        """Request the whole list, and then what was lost; `complete` tells whether all came."""
        async with self._turn:
            if not self.complete.is_set():
                await self._list()

    async def _list(self) -> None:
        vehicle, module = self._vehicle, self._hub.dialect.module
        to = (vehicle.system, vehicle.component)
        self._hub.send(vehicle, module.MAVLink_param_request_list_message(*to))
        for _ in range(_ROUNDS):
            self._last = time.monotonic()
            while time.monotonic() - self._last < _QUIET:
                try:
                    async with timeout(_QUIET):
                        await self.complete.wait()
                except TimeoutError:
                    continue
                return
            if self.count is None:
                self._hub.send(vehicle, module.MAVLink_param_request_list_message(*to))
                continue
            missing = [place for place in range(self.count) if place not in self._listed]
            for place in missing[:_AT_ONCE]:
                self._hub.send(vehicle, module.MAVLink_param_request_read_message(*to, b"", place))

    async def read(self, name: str) -> float:
        """Request a value.

        :raises UnknownPath: no such parameter; most vehicles then do not respond.
        """
        module, vehicle = self._hub.dialect.module, self._vehicle
        message = module.MAVLink_param_request_read_message(
            vehicle.system, vehicle.component, name.encode(), -1
        )
        doubtful = self.complete.is_set() and name not in self.known
        value = await self._exchange(name, message, lambda _: True, once=doubtful)
        if value is not None:
            return value
        if name in self.known:
            raise DeviceTimeout(f"the vehicle did not report {name}")
        raise self._unknown(name)

    def _unknown(self, name: str) -> UnknownPath:
        near = nearest(name, self.known)
        remedy = (
            f"Did you mean {' or '.join(near)}?" if near else "See param/* for existing parameters."
        )
        return UnknownPath(f"the vehicle has no parameter {name}", remedy=remedy)

    async def write(self, name: str, value: float) -> float:
        """Write a value; return the value in effect.

        :raises DeviceRejected: the vehicle kept the old one.
        :raises OutOfRange: its type cannot have this value.
        :raises UnknownPath: it no longer has the parameter.
        """
        vehicle, before = self._vehicle, self.known.get(name)
        if before is None:
            raise self._unknown(name)
        limits = bounds(before.type)
        if limits is not None and not limits[0] <= value <= limits[1]:
            raise OutOfRange(f"{name} must be {limits[0]} to {limits[1]}, not {value:g}")
        if limits is None and abs(value) > _LARGEST:
            raise OutOfRange(f"{name} must be -{_LARGEST:g} to {_LARGEST:g}, not {value:g}")
        to = (vehicle.system, vehicle.component)
        message, wanted = param_set(
            self._hub.dialect.module, to, name, value, before.type, bytewise=vehicle.bytewise
        )
        # A value sent just before the write may still arrive; it is not the reply.
        now = await self._exchange(
            name,
            message,
            lambda reported: reported in (wanted, value),
            before=lambda: check_sent(name, armed=vehicle.armed),
        )
        if now is None:
            raise DeviceTimeout(f"the vehicle did not confirm {name}")
        if now != wanted and now == before.value:
            texts = vehicle.texts_since(time.monotonic() - 1.0)
            raise DeviceRejected(f"the vehicle keeps {name} at {now:g}", details={"texts": texts})
        return now

    async def _exchange(
        self,
        name: str,
        message: Any,
        good: Callable[[float], bool],
        *,
        once: bool = False,
        before: Callable[[], None] = lambda: None,
    ) -> float | None:
        """Send until an accepted value arrives; return the last one received, or None.

        `before` is called before each sending, and raises to refuse it.
        """
        self._vehicle.check()
        config, own = self._hub.config, name.encode()
        answered: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        received: float | None = None

        def take(frame: Frame) -> None:
            nonlocal received
            fields = frame.fields()
            if fields["param_id"].split(b"\0", 1)[0] != own or answered.done():
                return
            if "error" in fields:
                answered.set_result(fields["error"])
                return
            received = self._decoded(frame, fields["param_type"])
            if good(received):
                answered.set_result(0)

        with ExitStack() as stack:
            for kind in ("PARAM_VALUE", "PARAM_ERROR"):
                if kind in self._hub.dialect.by_name:
                    stack.enter_context(self._vehicle.listening(kind, take))
            for _ in range(1 if once else config.retries + 1):
                before()
                self._hub.send(self._vehicle, message)
                done, _pending = await asyncio.wait({answered}, timeout=config.timeout)
                if done or received is not None:
                    break
                self._vehicle.check()
        if answered.done() and (error := answered.result()):
            raise self._refusal(name, error)
        return received

    def _refusal(self, name: str, error: int) -> RcpError:
        if error == _NOT_THERE:
            return self._unknown(name)
        words = _ERRORS.get(error, f"error {error}")
        return DeviceRejected(f"{name}: {words}", details={"result": words})

    def _decoded(self, frame: Frame, type_: int) -> float:
        raw = frame.payload[:4].ljust(4, b"\0")
        return decoded(raw, type_, bytewise=self._vehicle.bytewise)


def _kept_type(listed: int, reported: int, value: float) -> int:
    """Return the type of a parameter from its listed type and that of a later value.

    ArduPilot reports REAL32 for an integer that is set to the default that it already has.
    """
    limits = bounds(listed)
    if reported != REAL or limits is None or not value.is_integer():
        return reported
    return listed if limits[0] <= value <= limits[1] else reported
