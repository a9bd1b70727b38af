"""Missions, fences and rally points: upload and download."""

from __future__ import annotations

import asyncio
import difflib
import math
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

from rcp_kernel.errors import DeviceRejected, DeviceTimeout, InvalidValue, RcpError
from rcp_mavlink.frames import Frame
from rcp_mavlink.hub import Hub
from rcp_mavlink.messages import Item
from rcp_mavlink.plan_files import Names
from rcp_mavlink.terrain import check_offered
from rcp_mavlink.vehicle import Vehicle

__all__ = ["FENCE", "MISSION", "RALLY", "Plans"]

MISSION, FENCE, RALLY = 0, 1, 2
_FRAMES = {"relative": 6, "absolute": 5, "terrain": 11, "mission": 2}
_WORDS = {0: "absolute", 2: "mission", 3: "relative", 5: "absolute", 6: "relative", 10: "terrain", 11: "terrain"}  # fmt: skip
_RESULTS = {
    1: "failed", 2: "unsupported frame", 3: "unknown command", 4: "no space left",
    5: "invalid item", 6: "invalid parameter 1", 7: "invalid parameter 2", 8: "invalid parameter 3",
    9: "invalid parameter 4", 10: "invalid latitude", 11: "invalid longitude",
    12: "invalid altitude", 13: "invalid sequence", 14: "denied", 15: "cancelled",
}  # fmt: skip
_MIXED = "An ArduPilot replaces its mission item by item: it may have a part of each. Upload it again before it flies."
_ERROR, _INVALID_SEQUENCE = 1, 13
_NEAR = 1e-6  # deg
_PARAMS = ("param1", "param2", "param3", "param4")
_GLOBAL = frozenset({"relative", "absolute", "terrain"})

_Received = asyncio.Queue[tuple[str, dict[str, Any]]]


class Plans:
    """The plans of one vehicle; one transfer at a time."""

    def __init__(self, hub: Hub, vehicle: Vehicle) -> None:
        self._hub, self._vehicle = hub, vehicle
        self._turn = asyncio.Lock()
        self._begun = False
        """Whether an item of the present upload has been sent."""
        self._commands: dict[str, int] = {
            entry.name.removeprefix("MAV_CMD_"): number
            for number, entry in hub.dialect.module.enums["MAV_CMD"].items()
        }
        self.names = Names({n: name for name, n in self._commands.items()}, self._commands)

    def number(self, item: Item, place: int) -> int:
        """Return the number of an item's command.

        :raises InvalidValue: the dialect has no such command.
        """
        name = item.command.removeprefix("MAV_CMD_")
        number = int(name) if name.isdigit() else self._commands.get(name)
        if number is None or number > 65535:
            near = difflib.get_close_matches(name, self._commands, 3, 0.6)
            raise InvalidValue(
                f"there is no command {item.command}",
                remedy=f"Did you mean {' or '.join(near)}?" if near else None,
                details={"pointer": f"/items/{place}/command"},
            )
        return number

    def _home(self) -> Any:
        """Return item 0 of an ArduPilot mission, which is always home."""
        lat, lon, alt = self._vehicle.home or (0.0, 0.0, 0.0)
        return self._item(MISSION, 0, 16, 0, (), round(lat * 1e7), round(lon * 1e7), alt)

    def _item(
        self, kind: int, seq: int, number: int, frame: int, params: Sequence[float | None], x: int, y: int, z: float
    ) -> Any:  # fmt: skip
        vehicle = self._vehicle
        unset = math.nan if vehicle.family.px4 else 0.0
        p = [unset if each is None else each for each in [*params, 0.0, 0.0, 0.0, 0.0][:4]]
        return self._hub.dialect.module.MAVLink_mission_item_int_message(
            vehicle.system, vehicle.component, seq, frame, number, 0, 1, *p, x, y, z, kind
        )

    def _messages(self, kind: int, items: Sequence[Item]) -> list[Any]:
        made = [self._home()] if self.has_home(kind) and items else []
        for place, item in enumerate(items):
            number = self.number(item, place)
            scale = 1e7 if item.frame in _GLOBAL else 1
            x, y = round(item.latitude * scale), round(item.longitude * scale)
            made.append(
                self._item(
                    kind, len(made), number, _FRAMES[item.frame], item.params, x, y, item.altitude
                )
            )
        return made

    def has_home(self, kind: int) -> bool:
        """Tell whether the vehicle counts home as item 0 of a plan."""
        return kind == MISSION and not self._vehicle.family.px4

    async def upload(
        self, kind: int, items: Sequence[Item], progress: Callable[[float], None] | None = None
    ) -> int:
        """Replace a plan; return how many items the vehicle accepted.

        :raises DeviceRejected: the vehicle refuses the plan; includes its reason.
        :raises DeviceTimeout: it does not respond, and does not have the plan.
        :raises UnsupportedOperation: heights above the ground are for vehicles that know it.
        """
        if any(item.frame == "terrain" for item in items):
            check_offered(self._vehicle, "the plan")
        messages = self._messages(kind, items)
        vehicle, module = self._vehicle, self._hub.dialect.module
        count = module.MAVLink_mission_count_message(
            vehicle.system, vehicle.component, len(messages), kind
        )
        async with self._turn:
            try:
                doubt = await self._offer(kind, count, messages, progress)
            except RcpError as error:
                if self.has_home(kind) and self._begun:
                    error.remedy = _MIXED
                raise
        if doubt is not None and not _are_alike(items, await self.download(kind)):
            raise doubt
        return len(items)

    async def _offer(
        self,
        kind: int,
        count: Any,
        messages: Sequence[Any],
        progress: Callable[[float], None] | None,
    ) -> RcpError | None:
        """Send what the vehicle requests; return None if it accepts the plan, or why that is not certain.

        If its last answer was lost, an ArduPilot answers the last item, sent again, with an error.
        """
        vehicle = self._vehicle
        with self._following("MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK") as received:
            last, self._begun = count, False
            while True:
                is_last = bool(messages) and last is messages[-1]
                try:
                    name, fields = await self._next_message(received, last, kind, "upload")
                except DeviceTimeout as error:
                    if is_last and not vehicle.lost:
                        return error
                    raise
                if name == "MISSION_ACK":
                    if last is not count and fields["type"] == _INVALID_SEQUENCE:
                        continue  # of an item sent again: its next request was lost
                    refusal = self._refusal(fields["type"], "the plan is refused")
                    if refusal is None or (is_last and fields["type"] == _ERROR):
                        return refusal
                    raise refusal
                seq = fields["seq"]
                if seq >= len(messages):
                    raise DeviceRejected(f"the vehicle requested item {seq}, which does not exist")
                last, self._begun = messages[seq], True
                self._hub.send(vehicle, last)
                if progress is not None:
                    progress(seq / len(messages))

    async def download(self, kind: int) -> tuple[Item, ...]:
        """Return the plan stored on the vehicle."""
        vehicle, module = self._vehicle, self._hub.dialect.module
        to = (vehicle.system, vehicle.component)
        found: list[Item] = []
        async with self._turn:
            names = "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ACK"
            with self._following(*names) as received:
                request = module.MAVLink_mission_request_list_message(*to, kind)
                self._hub.send(vehicle, request)
                _, count = await self._next_message(
                    received, request, kind, "download", "MISSION_COUNT"
                )
                for seq in range(count["count"]):
                    request = module.MAVLink_mission_request_int_message(*to, seq, kind)
                    self._hub.send(vehicle, request)
                    while True:
                        _, fields = await self._next_message(
                            received, request, kind, "download", "MISSION_ITEM_INT"
                        )
                        if fields["seq"] == seq:
                            break
                    found.append(self._read(fields))
                done = module.MAVLink_mission_ack_message(*to, 0, kind)
                self._hub.send(vehicle, done)
        return tuple(found[1:] if self.has_home(kind) else found)

    def _read(self, f: dict[str, Any]) -> Item:
        frame: Any = _WORDS.get(f["frame"], "mission")
        scale = 1e7 if frame in _GLOBAL else 1
        unset = None if self._vehicle.family.px4 else 0.0
        params = tuple(unset if math.isnan(f[p]) else f[p] for p in _PARAMS)
        name = self.names.by_number.get(f["command"], str(f["command"]))
        return Item(name, f["x"] / scale, f["y"] / scale, f["z"], frame, params)

    async def _next_message(
        self, received: _Received, request: Any, kind: int, what: str, wanted: str | None = None
    ) -> tuple[str, dict[str, Any]]:  # fmt: skip
        """Return the next message of this transfer; repeats the last request meanwhile.

        :raises DeviceTimeout: the vehicle does not respond.
        """
        config = self._hub.config
        if wanted is None and "COUNT" in request.get_type():
            self._hub.send(self._vehicle, request)
        for _ in range(config.retries + 1):
            try:
                async with asyncio.timeout(config.timeout):
                    while True:
                        name, fields = await received.get()
                        if fields.get("mission_type", 0) != kind:
                            continue
                        if name == "MISSION_ACK" and wanted is not None:
                            if refusal := self._refusal(fields["type"], f"the {what} was ended"):
                                raise refusal
                            continue
                        if wanted is None or name == wanted:
                            return name, fields
            except TimeoutError:
                self._vehicle.check()
                self._hub.send(self._vehicle, request)
        raise DeviceTimeout(f"the vehicle stopped responding during the {what} of a plan")

    @contextmanager
    def _following(self, *names: str) -> Generator[_Received]:
        """Collect messages that the vehicle sends to this gateway, while entered."""
        received = _Received()

        def take(frame: Frame) -> None:
            fields = frame.fields()
            if self._hub.is_target(fields):
                received.put_nowait((frame.definition.name, fields))

        with ExitStack() as stack:
            for name in names:
                stack.enter_context(self._vehicle.listening(name, take))
            yield received

    @staticmethod
    def _refusal(result: int, what: str) -> DeviceRejected | None:
        if result == 0:
            return None
        return DeviceRejected(f"{what}: {_RESULTS.get(result, f'result {result}')}")


def _are_alike(sent: Sequence[Item], kept: Sequence[Item]) -> bool:
    """Return whether a vehicle keeps a plan, whose frames and heights it may write in another way."""
    return len(sent) == len(kept) and all(
        a.command.removeprefix("MAV_CMD_") == b.command.removeprefix("MAV_CMD_")
        and abs(a.latitude - b.latitude) < _NEAR
        and abs(a.longitude - b.longitude) < _NEAR
        for a, b in zip(sent, kept, strict=True)
    )
