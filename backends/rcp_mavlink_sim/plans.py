"""Missions, fences and rally points: the upload and download protocol."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import msgspec

from rcp_mavlink_sim.faults import Faults
from rcp_mavlink_sim.wire import mav

__all__ = ["MISSION_COMMANDS", "Item", "Plan", "Transfer"]

_SCALE = 1e7
_MOST_OF_ALL = 1e6  # limit of any parameter
_AGAIN = 1.0  # s until an item is requested again
_PATIENCE = 8  # requests
_MOST = {mav.MAV_MISSION_TYPE_MISSION: 724, mav.MAV_MISSION_TYPE_FENCE: 84, mav.MAV_MISSION_TYPE_RALLY: 60}  # fmt: skip
MISSION_COMMANDS = frozenset({16, 17, 18, 19, 20, 21, 22, 82, 93, 112, 115, 177, 178, 179, 181, 183, 201, 203, 205, 206, 207, 1000, 2000})  # fmt: skip
_FENCE_COMMANDS = frozenset({5000, 5001, 5002, 5003, 5004})
_RALLY_COMMANDS = frozenset({5100})
_KNOWN = {0: MISSION_COMMANDS, 1: _FENCE_COMMANDS, 2: _RALLY_COMMANDS}
_NORMAL_FRAME: dict[int, int] = {6: 3, 5: 0, 11: 10}
_HEADED = frozenset({16, 17, 19, 21, 22, 82})
_LANDMARKS = frozenset({16, 17, 18, 19, 21, 22, 82, 179, 5000, 5001, 5002, 5003, 5004, 5100})


class Item(msgspec.Struct, frozen=True):
    """One item of a plan."""

    command: int
    frame: int
    params: tuple[float, float, float, float]
    lat: float  # deg
    lon: float  # deg
    alt: float  # m
    raw: tuple[int, int]
    """The first two coordinates as received."""


class Plan:
    """A stored plan of one type; item 0 of a mission is home."""

    def __init__(self, kind: int) -> None:
        self.kind = kind
        self.items: list[Item] = []
        self.number = 0
        """Number of changes."""

    def replace(self, items: list[Item]) -> None:
        """Replace the plan."""
        self.items = items
        self.number += 1


class Transfer:
    """An upload in progress, from one peer."""

    mixes = True
    """Whether missions and rally points are replaced item by item, as an ArduPilot does, and not at the end."""

    def __init__(
        self, plan: Plan, count: int, peer: tuple[int, int], now: float, faults: Faults
    ) -> None:
        self._plan, self._count, self._peer = plan, count, peer
        self._faults = faults
        self._items: list[Item] = []
        self._requested_at = now
        self._tries = 0
        self._mixes = self.mixes and plan.kind != mav.MAV_MISSION_TYPE_FENCE
        if self._mixes:
            plan.items = plan.items[:count]

    @property
    def plan(self) -> Plan:
        """The plan being received."""
        return self._plan

    def request_next(self, send: Callable[[Any], None], now: float) -> None:
        """Request the next item like ArduPilot, which does not use MISSION_REQUEST_INT."""
        self._requested_at = now
        system, component = self._peer
        send(
            mav.MAVLink_mission_request_message(
                system, component, len(self._items), self._plan.kind
            )
        )

    def late(self, send: Callable[[Any], None], now: float) -> bool:
        """Repeat an unanswered request; return whether to give up."""
        if now - self._requested_at > _AGAIN:
            self._tries += 1
            if self._tries > _PATIENCE:
                self._end(send, mav.MAV_MISSION_OPERATION_CANCELLED)
                return True
            self.request_next(send, now)
        return False

    def take(self, message: Any, send: Callable[[Any], None], now: float) -> bool:
        """Handle an item; return whether the transfer is complete."""
        if message.seq != len(self._items):
            self._answer_unexpected(send)
            return False
        if message.command not in _KNOWN[self._plan.kind] and not self._is_home(message):
            self._end(send, mav.MAV_MISSION_UNSUPPORTED)
            return True
        if (wrong := self._wrong(message)) is not None:
            self._end(send, wrong)
            return True
        if self._faults.storage_full and message.seq == self._count - 1:
            self._end(send, mav.MAV_MISSION_ERROR)
            return True
        self._items.append(_item(message, self._plan.kind))
        self._tries = 0
        if self._mixes:
            self._plan.items = [*self._items, *self._plan.items[len(self._items) :]]
        if len(self._items) < self._count:
            self.request_next(send, now)
            return False
        self._plan.replace(self._stored())
        self._end(send, mav.MAV_MISSION_ACCEPTED)
        return True

    def _wrong(self, message: Any) -> int | None:
        return _wrong(message)

    def _stored(self) -> list[Item]:
        return self._items

    def _is_home(self, message: Any) -> bool:
        return self._plan.kind == mav.MAV_MISSION_TYPE_MISSION and message.seq == 0

    def _answer_unexpected(self, send: Callable[[Any], None]) -> None:
        """Answer an item out of turn, as one sent again, and go on."""
        self._end(send, mav.MAV_MISSION_INVALID_SEQUENCE)

    def is_last(self, message: Any) -> bool:
        """Return whether an item is the last one of this upload."""
        return message.mission_type == self._plan.kind and message.seq == self._count - 1

    def _end(self, send: Callable[[Any], None], result: int) -> None:
        send(mav.MAVLink_mission_ack_message(*self._peer, result, self._plan.kind))

    @staticmethod
    def refusal(kind: int, count: int) -> int | None:
        """Return why an upload cannot start, as MAV_MISSION_RESULT; None if it can."""
        if kind not in _MOST:
            return mav.MAV_MISSION_UNSUPPORTED
        return mav.MAV_MISSION_NO_SPACE if count > _MOST[kind] else None


def _wrong(message: Any) -> int | None:
    """Return which parameter is invalid, as MAV_MISSION_RESULT; a heading may be NaN."""
    first: int = mav.MAV_MISSION_INVALID_PARAM1
    given = (message.param1, message.param2, message.param3, message.param4, message.z)
    for at, value in enumerate(given):
        heading = at == 3 and math.isnan(value) and message.command in _HEADED
        if not (abs(value) <= _MOST_OF_ALL or heading):
            return mav.MAV_MISSION_INVALID_PARAM7 if at == 4 else first + at
    if message.command in _LANDMARKS:
        scale = _SCALE if message.get_type() == "MISSION_ITEM_INT" else 1.0
        if not abs(message.x) <= 90 * scale:
            return mav.MAV_MISSION_INVALID_PARAM5_X
        if not abs(message.y) <= 180 * scale:
            return mav.MAV_MISSION_INVALID_PARAM6_Y
    return None


def _item(message: Any, kind: int) -> Item:
    whole = message.get_type() == "MISSION_ITEM_INT"
    place = message.command in _LANDMARKS
    x, y = (message.x, message.y) if whole else (message.x * _SCALE, message.y * _SCALE)
    raw = (int(message.x), int(message.y)) if not place and not whole else (round(x), round(y))
    params = (message.param1, message.param2, message.param3, message.param4)
    frame: int = message.frame
    if frame in _NORMAL_FRAME:
        frame = _NORMAL_FRAME[frame]
    height = message.z
    if kind == mav.MAV_MISSION_TYPE_FENCE:  # fences keep only this
        frame, height, params = mav.MAV_FRAME_GLOBAL, 0.0, (message.param1, 0.0, 0.0, 0.0)
    return Item(message.command, frame, params, x / _SCALE, y / _SCALE, height, raw)
