"""Raw frames: subscribe, send and record."""

from __future__ import annotations

import struct
from collections.abc import Callable, Generator
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from rcp_can import messages as m
from rcp_can.binding import Part
from rcp_can.bus import Bus
from rcp_can.recording import Recording
from rcp_kernel.errors import InvalidValue, PreconditionFailed
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host, Progress, check_fence

if TYPE_CHECKING:
    import can

__all__ = ["NATIVE", "BusPart", "RawFrame", "pack"]

NATIVE = "linux/can_frame"
_EXTENDED, _REMOTE, _ERROR = 0x80000000, 0x40000000, 0x20000000
_FD_SIZES = frozenset((*range(9), 12, 16, 20, 24, 32, 48, 64))


def pack(message: can.Message) -> bytes:
    """Return a frame as Linux's `can_frame` (16 bytes) or `canfd_frame` (72 bytes)."""
    identifier = (
        message.arbitration_id
        | (_EXTENDED if message.is_extended_id else 0)
        | (_REMOTE if message.is_remote_frame else 0)
        | (_ERROR if message.is_error_frame else 0)
    )
    data = bytes(message.data)
    flags = (message.bitrate_switch | message.error_state_indicator << 1) if message.is_fd else 0
    size = len(data) if message.is_fd else message.dlc
    return struct.pack("<IBBxx", identifier, size, flags) + data.ljust(
        64 if message.is_fd else 8, b"\0"
    )


class RawFrame:
    """A received frame, decoded only when needed."""

    __slots__ = ("_message", "data")

    def __init__(self, message: can.Message) -> None:
        self._message = message
        self.data = pack(message)

    def decode(self) -> m.Frame:
        """Decode the frame."""
        message = self._message
        return m.Frame(
            id=message.arbitration_id,
            data=bytes(message.data),
            extended=message.is_extended_id,
            remote=message.is_remote_frame,
            fd=message.is_fd,
            bitrate_switch=message.bitrate_switch,
            error=message.is_error_frame,
        )


class BusPart(Part):
    """The resources of one bus."""

    def __init__(self, bus: Bus, host: Host) -> None:
        self._bus, self._host = bus, host
        self._recording: Recording | None = None
        name = f"can/{bus.name}"
        self._frame, self._send = f"event/{name}/frame", f"actuator/{name}/frame"
        self._start, self._stop = f"service/{name}/start_log", f"service/{name}/stop_log"
        self._wanted = _wanted(bus.config.ranges)

    def resources(self) -> list[Resource]:
        """List the resources of the bus."""
        bus, name = self._bus, f"can/{self._bus.name}"
        found = [
            Resource(
                name=f"sensor/{name}/state",
                description=f"State of the controller of CAN bus '{bus.name}'.",
                value=m.BusState,
                live=True,
            ),
            Resource(
                name=f"sensor/{name}/statistics",
                description=f"Load, rates and counts of CAN bus '{bus.name}'.",
                value=m.Statistics,
                live=True,
                deadline=3 * bus.config.statistics,
            ),
            Resource(
                name=f"event/{name}/state",
                description="Bus-off, restarts, controller warnings, loss of the interface.",
                value=m.BusEvent,
                live=True,
            ),
            Resource(
                name=f"event/{name}/overflow",
                description="Frames were dropped: a queue was full, or they expired in it.",
                value=m.Overflow,
                live=True,
            ),
            Resource(
                name=self._frame,
                description="Every frame on the bus, including sent ones; filter with `where` on `id`.",
                value=m.Frame,
                native=NATIVE,
                history=1,
            ),
        ]
        if bus.config.raw_send:
            found.append(
                Resource(
                    name=self._send,
                    description="Send any frame, bypassing the checks on motors.",
                    value=m.Frame,
                    moves=True,
                    examples=({"id": 0x7DF, "data": "AgEMAAAAAAA="}, {"id": 0x123}),
                    max_age=1.0,
                )
            )
        if bus.config.log_directory is not None:
            found += [
                Resource(
                    name=self._start,
                    description="Record every frame to a new file.",
                    input=m.StartLog,
                    output=m.LogFile,
                    examples=({"format": "candump"},),
                ),
                Resource(
                    name=self._stop,
                    description="Stop the recording.",
                    output=m.LogFile,
                ),
            ]
        return found

    async def read(self, name: str) -> Any:
        """Return state or statistics; frames cannot be read."""
        match name.rpartition("/")[2]:
            case "state" if name.startswith("sensor/"):
                return self._bus.reported_state
            case "statistics":
                return self._bus.statistics()
            case _:
                return await super().read(name)

    async def write(self, name: str, value: m.Frame) -> None:
        """Send a frame."""
        config, size = self._bus.config, len(value.data)
        if value.error:
            raise InvalidValue("an error frame cannot be sent", details={"pointer": "/error"})
        if value.fd and not config.fd:
            raise InvalidValue(
                f"bus '{self._bus.name}' is not CAN FD",
                details={"pointer": "/fd"},
                remedy=f"Set `fd = true` in buses.{self._bus.name}, or send a classic frame.",
            )
        if size > 8 and not value.fd:
            raise InvalidValue("more than 8 bytes require `fd`", details={"pointer": "/data"})
        if size not in _FD_SIZES:
            raise InvalidValue(f"a frame cannot have {size} bytes", details={"pointer": "/data"})
        if value.id > 0x7FF and not value.extended:
            raise InvalidValue("an id above 0x7FF requires `extended`", details={"pointer": "/id"})
        check_fence()
        self._bus.send(
            value.id,
            value.data,
            extended=value.extended,
            remote=value.remote,
            fd=value.fd,
            switched=value.bitrate_switch,
        )

    def watch(self, name: str) -> AbstractContextManager[object]:
        """Publish frames only while a client subscribes."""
        return self._watched() if name == self._frame else super().watch(name)

    @contextmanager
    def _watched(self) -> Generator[None]:
        def tap(message: can.Message) -> None:
            if self._wanted(message.arbitration_id):
                stamp = int(message.timestamp * 1e9) or None
                self._host.publish(self._frame, RawFrame(message), stamp)

        self._bus.taps.append(tap)
        try:
            yield
        finally:
            self._bus.taps.remove(tap)

    async def execute(self, name: str, value: Any, progress: Progress) -> m.LogFile:
        """Start or stop recording."""
        if name == self._start:
            if self._recording is not None:
                raise PreconditionFailed(
                    f"'{self._recording.file}' is already being recorded",
                    remedy=f"Execute {self._stop} first.",
                )
            directory = self._bus.config.log_directory or "."
            self._recording = await Recording.start(directory, self._bus.name, value.format)
            self._bus.taps.append(self._recording.tap)
            return self._recording.log_file()
        if self._recording is None:
            raise PreconditionFailed(
                "nothing is being recorded", remedy=f"Execute {self._start} first."
            )
        return await self._end(self._recording)

    async def _end(self, recording: Recording) -> m.LogFile:
        self._recording = None
        self._bus.taps.remove(recording.tap)
        await recording.stop()
        return recording.log_file()

    async def close(self) -> None:
        """Stop a recording in progress."""
        if self._recording is not None:
            await self._end(self._recording)


def _wanted(ranges: list[tuple[int, int]]) -> Callable[[int], bool]:
    if not ranges:
        return lambda _: True

    @lru_cache(maxsize=4096)
    def wanted(identifier: int) -> bool:
        return any(low <= identifier <= high for low, high in ranges)

    return wanted
