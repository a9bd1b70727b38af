"""Missions, fences and rally points: upload and download."""

from __future__ import annotations

import asyncio
import math
import time
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
from rcp_protocol.similarity import nearest
from rcp_protocol.timeouts import timeout

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
_MIXED = "An ArduPilot replaces its mission and its rally points item by item: it may have a part of each. Upload it again before it flies."
_UNSURE = "the answer to the last item was lost, and the vehicle is not seen to have the plan"
_SEE = "Download the plan to see what the vehicle has, and upload it again before it flies."
_ERROR, _INVALID_SEQUENCE = 1, 13
_STUCK = 20.0  # s without a request for another item, after which a refusal counts
_RECEIVING = (
    9.0  # s for an ArduPilot to give up an upload that broke off; it denies a download until then
)
_NEAR = 1.5e-7  # deg: one unit of the wire
_LEVEL = 0.011  # m: an ArduPilot keeps centimetres
_SHARE, _LEAST = 1e-5, 1e-4  # of a parameter, which is stored in 32 bits
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
            near = nearest(name, self._commands)
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

    def is_mixed(self, kind: int) -> bool:
        """Tell whether the vehicle replaces a plan item by item, and not at the end of an upload."""
        return kind != FENCE and not self._vehicle.family.px4

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
                if doubt is not None and not await self._has(kind, messages):
                    raise doubt
            except RcpError as error:
                if self.is_mixed(kind) and self._begun:
                    error.remedy = _MIXED
                raise
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
            last, self._begun, sent = count, False, set[int]()
            again, since = False, time.monotonic()
            while True:
                is_last = bool(messages) and last is messages[-1]
                try:
                    name, fields, repeated = await self._next_message(
                        received, last, kind, "upload"
                    )
                except DeviceTimeout as error:
                    if is_last and not vehicle.lost:
                        return error
                    raise
                again = again or repeated
                if name == "MISSION_ACK":
                    is_stuck = time.monotonic() - since > _STUCK
                    if last is not count and fields["type"] == _INVALID_SEQUENCE and not is_stuck:
                        continue  # of an item sent again: its next request was lost
                    if is_last and again and fields["type"] == _ERROR:
                        return DeviceTimeout(_UNSURE, remedy=_SEE)
                    refusal = self._refusal(fields["type"], "the plan is refused")
                    if refusal is not None:
                        raise refusal
                    if len(sent) < len(messages):
                        continue  # of an upload before: it does not have this plan yet
                    return None
                seq = fields["seq"]
                if seq >= len(messages):
                    raise DeviceRejected(f"the vehicle requested item {seq}, which does not exist")
                again = last is messages[seq]
                if not again:
                    since = time.monotonic()
                last, self._begun = messages[seq], True
                sent.add(seq)
                self._hub.send(vehicle, last)
                if progress is not None:
                    progress(seq / len(messages))

    async def _has(self, kind: int, messages: Sequence[Any]) -> bool:
        """Return whether the vehicle is seen to have the plan that it was sent."""
        try:
            kept = await self._download(kind, time.monotonic() + _RECEIVING)
        except RcpError:
            return False
        sent = messages[1:] if self.has_home(kind) else messages
        return len(sent) == len(kept) and all(
            self._is_alike(kind, self._read({f: getattr(one, f) for f in one.fieldnames}), other)
            for one, other in zip(sent, kept, strict=True)
        )

    def _is_alike(self, kind: int, sent: Item, kept: Item) -> bool:
        """Return whether an item is the one that was sent, in all that the vehicle stores of one."""
        if sent.command != kept.command:
            return False
        if not (
            abs(sent.latitude - kept.latitude) < _NEAR
            and abs(sent.longitude - kept.longitude) < _NEAR
        ):
            return False
        if kind == FENCE:  # it has the radius, or the number of corners, and no height
            return _is_same(sent.params[0], kept.params[0])
        number = self._commands.get(sent.command)
        places = number is None or self._hub.dialect.module.enums["MAV_CMD"][number].has_location
        return (
            (sent.frame == kept.frame or not places)
            and abs(sent.altitude - kept.altitude) < _LEVEL
            and all(map(_is_same, sent.params, kept.params))
        )

    async def download(self, kind: int) -> tuple[Item, ...]:
        """Return the plan stored on the vehicle."""
        async with self._turn:
            return await self._download(kind)

    async def _download(self, kind: int, patience: float = 0.0) -> tuple[Item, ...]:
        """Return the plan; `patience` is until when (monotonic s) a denial is not the last word.

        After an upload that broke off, refusals may be answers to that.
        """
        vehicle, module = self._vehicle, self._hub.dialect.module
        to = (vehicle.system, vehicle.component)
        found: list[Item] = []
        with self._following("MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ACK") as received:
            request = module.MAVLink_mission_request_list_message(*to, kind)
            self._hub.send(vehicle, request)
            while True:
                try:
                    _, count, _ = await self._next_message(
                        received, request, kind, "download", "MISSION_COUNT"
                    )
                    break
                except DeviceRejected:
                    if time.monotonic() >= patience:
                        raise
            for seq in range(count["count"]):
                request = module.MAVLink_mission_request_int_message(*to, seq, kind)
                self._hub.send(vehicle, request)
                while True:
                    _, fields, _ = await self._next_message(
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
    ) -> tuple[str, dict[str, Any], bool]:  # fmt: skip
        """Return the next message of this transfer, and whether the last request was repeated meanwhile.

        :raises DeviceTimeout: the vehicle does not respond.
        """
        config = self._hub.config
        if wanted is None and "COUNT" in request.get_type():
            self._hub.send(self._vehicle, request)
        for tries in range(config.retries + 1):
            try:
                async with timeout(config.timeout):
                    while True:
                        name, fields = await received.get()
                        if fields.get("mission_type", 0) != kind:
                            continue
                        if name == "MISSION_ACK" and wanted is not None:
                            if refusal := self._refusal(fields["type"], f"the {what} was ended"):
                                raise refusal
                            continue
                        if wanted is None or name == wanted:
                            return name, fields, tries > 0
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


def _is_same(sent: float | None, kept: float | None) -> bool:
    """Return whether a parameter is the one that was sent, where None is not set."""
    if sent is None or kept is None:
        return sent is kept
    return math.isclose(sent, kept, rel_tol=_SHARE, abs_tol=_LEAST)
