"""The connection of a ground station with PX4: its mission protocol, and its set-points."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from rcp_mavlink_sim import commands, setpoints
from rcp_mavlink_sim.ground_station import GroundStation
from rcp_mavlink_sim.plans import Item, Plan, Transfer
from rcp_mavlink_sim.px4.commands import DOERS
from rcp_mavlink_sim.px4.flight import Px4Flight
from rcp_mavlink_sim.px4.parameters import Px4Parameters
from rcp_mavlink_sim.vehicle import Vehicle
from rcp_mavlink_sim.wire import mav

__all__ = ["Px4GroundStation"]

_FRAMES = frozenset({0, 2, 3, 5, 6})
_HOME = Item(16, 0, (0.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, (0, 0))
_NO_PLACE, _NO_VELOCITY, _NO_YAW, _NO_YAW_RATE = 0b111, 0b111000, 1 << 10, 1 << 11


class _Transfer(Transfer):
    """An upload that asks by MISSION_REQUEST_INT; home is no part of a mission."""

    mixes = False

    def request_next(self, send: Callable[[Any], None], now: float) -> None:
        """Request the next item."""
        self._requested_at = now
        kind = self._plan.kind
        send(mav.MAVLink_mission_request_int_message(*self._peer, len(self._items), kind))

    def _is_home(self, message: Any) -> bool:
        return False

    def _answer_unexpected(self, send: Callable[[Any], None]) -> None:
        """Ignore it."""

    def _wrong(self, message: Any) -> int | None:
        """Return why an item is refused, as MAV_MISSION_RESULT; parameters may be NaN."""
        if message.frame not in _FRAMES:
            return mav.MAV_MISSION_UNSUPPORTED_FRAME
        values = [message.param1, message.param2, message.param3, message.param4]
        if any(math.isinf(value) for value in values) or not abs(message.z) < 1e6:
            return mav.MAV_MISSION_INVALID
        return None

    def _stored(self) -> list[Item]:
        mission = self._plan.kind == mav.MAV_MISSION_TYPE_MISSION
        return [_HOME, *self._items] if mission and self._items else self._items


class Px4GroundStation(GroundStation):
    """One connection of a ground station."""

    transfer = _Transfer

    def _without_transfer(self, message: Any) -> int:
        """Accept the last item again: the answer to it was lost."""
        done = self._done
        is_known = done is not None and done.is_last(message)
        return mav.MAV_MISSION_ACCEPTED if is_known else mav.MAV_MISSION_ERROR

    def __init__(self, vehicle: Vehicle, send_bytes: Callable[[bytes], None]) -> None:
        super().__init__(vehicle, send_bytes)
        for absent in (
            "TERRAIN_DATA", "TERRAIN_CHECK", "RC_CHANNELS_OVERRIDE", "GLOBAL_POSITION_INT",
        ):  # fmt: skip
            del self.handlers[absent]

    def _heartbeat(self, message: Any) -> None:
        if message.type == mav.MAV_TYPE_GCS:
            self.vehicle.failsafes.on_station_heartbeat()

    def _run(self, message: Any) -> int:
        return commands.run(self, message, DOERS, frozenset())

    def _pitch_yaw(self, message: Any) -> None:
        mount = self.vehicle.gimbal(message.gimbal_device_id)
        sender = (message.get_srcSystem(), message.get_srcComponent())
        if mount is not None and mount.control == sender:
            super()._pitch_yaw(message)

    def _param_list(self, _: Any) -> None:
        params = self.vehicle.params
        assert isinstance(params, Px4Parameters)
        self.send(params.hashed())
        self._params = list(params.listed())

    def _setpoint(self, message: Any) -> None:
        """Take a set-point, of which each part that is NaN is left out."""
        flight = self.vehicle.flight
        assert isinstance(flight, Px4Flight)
        flight.hear()
        if message.get_type() != "SET_ATTITUDE_TARGET":
            _leave_out(message)
        setpoints.take(self.vehicle, message)

    # Missions

    def _counted(self, plan: Plan) -> int:
        return max(0, len(plan.items) - 1) if _is_mission(plan) else len(plan.items)

    def _receives(self, plan: Plan) -> bool:
        return False

    def _mission_request(self, message: Any) -> None:
        plan = self._plan(message.mission_type)
        client = (message.get_srcSystem(), message.get_srcComponent())
        if plan is None or message.seq >= self._counted(plan):
            wrong = mav.MAV_MISSION_INVALID_SEQUENCE
            self.send(mav.MAVLink_mission_ack_message(*client, wrong, message.mission_type))
            return
        item = plan.items[message.seq + _is_mission(plan)]
        frame = {0: 5, 3: 6}.get(item.frame, item.frame)
        current = int(_is_mission(plan) and message.seq + 1 == self.vehicle.flight.mission.current)
        self.send(
            mav.MAVLink_mission_item_int_message(
                *client, message.seq, frame, item.command, current, 1, *item.params, *item.raw, item.alt, plan.kind
            )
        )  # fmt: skip

    def _mission_current(self, message: Any) -> None:
        if self.vehicle.flight.mission.go_to(message.seq + 1):
            self.send(mav.MAVLink_mission_current_message(message.seq))


def _is_mission(plan: Plan) -> bool:
    return plan.kind == mav.MAV_MISSION_TYPE_MISSION


def _leave_out(message: Any) -> None:
    """Mark what is NaN as ignored."""
    place = (
        (message.x, message.y, message.z)
        if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED"
        else (message.alt,)
    )
    if any(map(math.isnan, place)):
        message.type_mask |= _NO_PLACE
    if any(map(math.isnan, (message.vx, message.vy, message.vz))):
        message.type_mask |= _NO_VELOCITY
    if math.isnan(message.yaw):
        message.type_mask, message.yaw = message.type_mask | _NO_YAW, 0.0
    if math.isnan(message.yaw_rate):
        message.type_mask, message.yaw_rate = message.type_mask | _NO_YAW_RATE, 0.0
