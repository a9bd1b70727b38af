"""On-board logs: listed, and read in ranges; lost chunks are requested again."""

from __future__ import annotations

import asyncio
from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_kernel.errors import DeviceTimeout, InvalidValue
from rcp_kernel.spi import Progress
from rcp_mavlink.frames import Frame
from rcp_mavlink.hub import Hub
from rcp_mavlink.vehicle import Vehicle
from rcp_protocol.timeouts import timeout

__all__ = ["LogPiece", "LogRange", "Logs", "OnBoard"]

_PIECE = 90  # bytes of LOG_DATA
_ROUNDS = 20
MOST = 1 << 20  # bytes per request

Bytes = Annotated[int, Meta(ge=0, le=2**32 - 1, extra_json_schema={"unit": "By"})]
Number = Annotated[int, Meta(ge=0, le=65535, extra_json_schema={"unit": "1"})]


class OnBoard(Struct, frozen=True):
    """One log on board."""

    id: Number
    size: Bytes
    time: Annotated[int, Meta(extra_json_schema={"unit": "s"})]
    """Time of creation, seconds since the UNIX epoch; 0 if unknown."""


class LogRange(Struct, frozen=True, forbid_unknown_fields=True):
    """A range of a log."""

    id: Number
    offset: Bytes = 0
    count: Annotated[int, Meta(ge=1, le=MOST, extra_json_schema={"unit": "By"})] = MOST


class LogPiece(Struct, frozen=True):
    """A part of a log; shorter than `count` at the end of the log."""

    id: Number
    offset: Bytes
    size: Bytes
    """Size of the whole log."""
    data: bytes


class Logs:
    """The logs of one vehicle; one transfer at a time."""

    def __init__(self, hub: Hub, vehicle: Vehicle) -> None:
        self._hub, self._vehicle = hub, vehicle
        self._turn = asyncio.Lock()

    async def list(self, _: None, progress: Progress) -> list[OnBoard]:
        """List the on-board logs."""
        async with self._turn:
            return await self._entries()

    async def _entries(self) -> list[OnBoard]:
        vehicle, module = self._vehicle, self._hub.dialect.module
        found: dict[int, OnBoard] = {}
        count: int | None = None
        arrived = asyncio.Event()

        def take(frame: Frame) -> None:
            nonlocal count
            f = frame.fields()
            count = f["num_logs"]
            if count:
                found[f["id"]] = OnBoard(f["id"], f["size"], f["time_utc"])
            arrived.set()

        request = module.MAVLink_log_request_list_message(
            vehicle.system, vehicle.component, 0, 0xFFFF
        )
        with vehicle.listening("LOG_ENTRY", take):
            for _ in range(self._hub.config.retries + 1):
                self._hub.send(vehicle, request)
                while (count is None or len(found) < count) and await self._more(arrived):
                    continue
                if count is not None and len(found) >= count:
                    return [found[number] for number in sorted(found)]
        raise DeviceTimeout("the vehicle did not list its logs")

    async def _more(self, arrived: asyncio.Event) -> bool:
        """Wait for data; return whether any arrived.

        :raises AdapterUnavailable: the vehicle is lost.
        """
        arrived.clear()
        try:
            async with timeout(self._hub.config.timeout):
                await arrived.wait()
        except TimeoutError:
            self._vehicle.check()
            return False
        return True

    async def read(self, given: LogRange, progress: Progress) -> LogPiece:
        """Return a part of a log.

        :raises InvalidValue: no such log.
        """
        async with self._turn:
            logs = {log.id: log for log in await self._entries()}
            log = logs.get(given.id)
            if log is None:
                raise InvalidValue(
                    f"there is no log {given.id}",
                    remedy="List existing logs with service/log/list.",
                    details={"pointer": "/id"},
                )
            end = min(log.size, given.offset + given.count)
            data = await self._range(given.id, given.offset, max(given.offset, end), progress)
            return LogPiece(given.id, given.offset, log.size, data)

    async def _range(self, number: int, start: int, end: int, progress: Progress) -> bytes:
        data, missing = bytearray(end - start), set(range(start, end, _PIECE))
        arrived = asyncio.Event()

        def take(frame: Frame) -> None:
            f = frame.fields()
            if f["id"] == number and f["ofs"] in missing:
                at = f["ofs"]
                piece = bytes(f["data"])[: min(f["count"], end - at)]
                data[at - start : at - start + len(piece)] = piece
                missing.discard(at)
                arrived.set()

        vehicle, module = self._vehicle, self._hub.dialect.module
        to = (vehicle.system, vehicle.component)
        whole = max(1, len(missing))
        with vehicle.listening("LOG_DATA", take):
            for _ in range(_ROUNDS):
                if not missing:
                    break
                first = min(missing)
                request: Any = module.MAVLink_log_request_data_message(
                    *to, number, first, end - first
                )
                self._hub.send(vehicle, request)
                while missing and await self._more(arrived):
                    progress(fraction=1 - len(missing) / whole)
            self._hub.send(vehicle, module.MAVLink_log_request_end_message(*to))
        if missing:
            raise DeviceTimeout(f"{len(missing)} pieces of log {number} did not arrive")
        return bytes(data)
