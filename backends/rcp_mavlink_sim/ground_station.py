"""The connection of a ground station: handles its messages and sends what is due."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, ClassVar

from rcp_mavlink_sim import commands, setpoints
from rcp_mavlink_sim.ftp import Ftp
from rcp_mavlink_sim.plans import Plan, Transfer
from rcp_mavlink_sim.streams import Streams
from rcp_mavlink_sim.telemetry import heartbeat
from rcp_mavlink_sim.vehicle import Vehicle
from rcp_mavlink_sim.wire import mav

__all__ = ["GroundStation"]

_PARAMS_A_TURN = 20
_LOG_PIECE, _LOG_A_TURN = 90, 40
_EPOCH = 1_420_070_400  # s: epoch of signature timestamps


class _Sink:
    """The output of pymavlink: collects frames to send together."""

    def __init__(self) -> None:
        self.frames: list[bytes] = []

    def write(self, frame: bytes) -> None:
        """Keep a frame until the next batch is sent."""
        self.frames.append(frame)


class GroundStation:
    """One connection of a ground station; `send_bytes` is called with one frame each."""

    transfer: ClassVar[type[Transfer]] = Transfer
    """Receives a plan."""

    def __init__(self, vehicle: Vehicle, send_bytes: Callable[[bytes], None]) -> None:
        self.vehicle = vehicle
        self.streams = Streams(vehicle)
        self._send_bytes = send_bytes
        self._sink = _Sink()
        self._mav: Any = mav.MAVLink(self._sink, vehicle.options.system, 1)
        self._mav.robust_parsing = True
        if vehicle.options.key is not None:
            signing = self._mav.signing
            signing.secret_key, signing.sign_outgoing = vehicle.options.key, True
            signing.timestamp = round((time.time() - _EPOCH) * 1e5)
        self._transfer: Transfer | None = None
        self._done: Transfer | None = None
        """The last upload that was complete."""
        self._ftp = Ftp(vehicle, self.send)
        self._params: list[str] = []
        self._log: tuple[int, int, int] | None = None
        self._tasks: list[Callable[[], None]] = []
        self.handlers: dict[str, Callable[[Any], None]] = {
            "HEARTBEAT": self._heartbeat,
            "COMMAND_LONG": self._command,
            "COMMAND_INT": self._command,
            "SET_MODE": self._set_mode,
            "PARAM_REQUEST_READ": self._param_read,
            "PARAM_REQUEST_LIST": self._param_list,
            "PARAM_SET": self._param_set,
            "MISSION_COUNT": self._mission_count,
            "MISSION_ITEM": self._mission_item,
            "MISSION_ITEM_INT": self._mission_item,
            "MISSION_REQUEST_LIST": self._mission_list,
            "MISSION_REQUEST": self._mission_request,
            "MISSION_REQUEST_INT": self._mission_request,
            "MISSION_CLEAR_ALL": self._mission_clear,
            "MISSION_SET_CURRENT": self._mission_current,
            "SET_GPS_GLOBAL_ORIGIN": self._origin,
            "REQUEST_DATA_STREAM": self._streams,
            "TIMESYNC": self._timesync,
            "SET_POSITION_TARGET_LOCAL_NED": self._setpoint,
            "SET_POSITION_TARGET_GLOBAL_INT": self._setpoint,
            "SET_ATTITUDE_TARGET": self._setpoint,
            "FILE_TRANSFER_PROTOCOL": self._ftp.take,
            "GIMBAL_MANAGER_SET_PITCHYAW": self._pitch_yaw,
            "GPS_RTCM_DATA": self._corrections,
            "FOLLOW_TARGET": self._leader,
            "GLOBAL_POSITION_INT": self._leader,
            "TERRAIN_DATA": self._terrain_data,
            "TERRAIN_CHECK": self._terrain_check,
            "MANUAL_CONTROL": self._sticks,
            "RC_CHANNELS_OVERRIDE": self._sticks,
            "LOG_REQUEST_LIST": self._log_list,
            "LOG_REQUEST_DATA": self._log_request,
            "LOG_REQUEST_END": self._log_end,
        }
        vehicle.on_message.append(self.send)

    def close(self) -> None:
        """Release it."""
        self.vehicle.on_message.remove(self.send)

    def send(self, message: Any) -> None:
        """Send a message to it with the next batch."""
        self._mav.send(message)

    def later(self, do: Callable[[], None]) -> None:
        """Run something after the reply has been sent."""
        self._tasks.append(do)

    def feed(self, data: bytes, *, datagram: bool = False) -> None:
        """Process received bytes; an incomplete frame at the end of a datagram is discarded."""
        faults = self.vehicle.faults
        if faults.uplink_cut or faults.frozen:
            return
        if datagram:
            self._mav.buf, self._mav.buf_index = bytearray(), 0
        for message in self._mav.parse_buffer(data) or ():
            if message.get_type() not in ("BAD_DATA", "UNKNOWN"):
                self._take(message)
        self.flush()

    def turn(self, wall: float) -> None:
        """Send what is due."""
        if self.vehicle.faults.frozen:
            return
        for message in self.streams.due(wall):
            self.send(message)
        self._list_params()
        self._send_log()
        self._ftp.turn()
        if self._transfer is not None and self._transfer.late(self.send, wall):
            self._transfer = None
        self.flush()

    def flush(self) -> None:
        """Send the queued messages."""
        frames, self._sink.frames = self._sink.frames, []
        for frame in frames if not self.vehicle.faults.downlink_cut else ():
            self._send_bytes(frame)
        tasks, self._tasks = self._tasks, []
        for task in tasks:
            task()

    def _take(self, message: Any) -> None:
        handler = self.handlers.get(message.get_type())
        target = getattr(message, "target_system", 0)
        if handler is not None and target in (0, self.vehicle.options.system):
            handler(message)

    def _heartbeat(self, message: Any) -> None:
        if message.get_srcSystem() == self.vehicle.params["MAV_GCS_SYSID"]:
            self.vehicle.failsafes.on_station_heartbeat()

    def _pitch_yaw(self, message: Any) -> None:
        locked = bool(message.flags & mav.GIMBAL_MANAGER_FLAGS_YAW_LOCK)
        pitch, yaw = math.degrees(message.pitch), math.degrees(message.yaw)
        mount = self.vehicle.gimbal(message.gimbal_device_id)
        if mount is not None:
            mount.turn(pitch, yaw, locked=locked)

    def _corrections(self, message: Any) -> None:
        self.vehicle.corrections.take(message)

    def _leader(self, message: Any) -> None:
        vehicle = self.vehicle
        if vehicle.home is not None and message.get_srcSystem() != vehicle.options.system:
            vehicle.leader.take(message, vehicle.wall, vehicle.home[2])

    def _terrain_data(self, message: Any) -> None:
        self.vehicle.terrain.take(message)

    def _terrain_check(self, message: Any) -> None:
        vehicle = self.vehicle
        if vehicle.position_ok and vehicle.terrain.enabled:
            place, above = (message.lat, message.lon), -vehicle.body.d
            self.send(vehicle.terrain.report(place, vehicle.ground_home, above))

    def _sticks(self, message: Any) -> None:
        vehicle = self.vehicle
        if message.get_srcSystem() != vehicle.params["MAV_GCS_SYSID"]:
            return
        until = vehicle.wall + vehicle.params["RC_OVERRIDE_TIME"]
        if message.get_type() == "MANUAL_CONTROL":
            if message.target == vehicle.options.system:
                vehicle.sticks.manual(message, until, drives=vehicle.kind.drives)
        else:
            vehicle.sticks.override(message, until)

    def _command(self, message: Any) -> None:
        result = self._run(message)
        system, component = message.get_srcSystem(), message.get_srcComponent()
        self.send(mav.MAVLink_command_ack_message(message.command, result, 0, 0, system, component))

    def _run(self, message: Any) -> int:
        return commands.run(self, message)

    def _set_mode(self, message: Any) -> None:
        done = self.vehicle.set_custom_mode(message.custom_mode)
        result = mav.MAV_RESULT_ACCEPTED if done else mav.MAV_RESULT_FAILED
        self.send(mav.MAVLink_command_ack_message(mav.MAVLINK_MSG_ID_SET_MODE, result))
        self.send(heartbeat(self.vehicle))

    # Parameters

    def _param_read(self, message: Any) -> None:
        self.vehicle.params.read(message, self.send)

    def _param_set(self, message: Any) -> None:
        vehicle = self.vehicle
        if vehicle.params.write(message, vehicle.broadcast):
            vehicle.flight.apply_parameters()

    def _param_list(self, _: Any) -> None:
        self.vehicle.greet(self.send)
        self._params = list(self.vehicle.params.listed())

    def _list_params(self) -> None:
        turn, self._params = self._params[:_PARAMS_A_TURN], self._params[_PARAMS_A_TURN:]
        for name in turn:
            self.send(self.vehicle.params.message(name))

    # Plans

    def _plan(self, kind: int) -> Plan | None:
        vehicle = self.vehicle
        plans = (vehicle.flight.mission.plan, vehicle.fence.plan, vehicle.rally)
        return plans[kind] if kind < len(plans) else None

    def _mission_count(self, message: Any) -> None:
        kind, client = message.mission_type, (message.get_srcSystem(), message.get_srcComponent())
        refusal = Transfer.refusal(kind, message.count)
        plan = self._plan(kind)
        if refusal is not None or plan is None:
            self.send(mav.MAVLink_mission_ack_message(*client, refusal or 0, kind))
            return
        if message.count == 0:
            self._stored(plan, [])
            self.send(mav.MAVLink_mission_ack_message(*client, mav.MAV_MISSION_ACCEPTED, kind))
            return
        vehicle, self._done = self.vehicle, None
        self._transfer = self.transfer(plan, message.count, client, vehicle.wall, vehicle.faults)
        self._transfer.request_next(self.send, self.vehicle.wall)

    def _mission_item(self, message: Any) -> None:
        transfer = self._transfer
        if transfer is None or transfer.plan.kind != message.mission_type:
            client = (message.get_srcSystem(), message.get_srcComponent())
            result = self._without_transfer(message)
            self.send(mav.MAVLink_mission_ack_message(*client, result, message.mission_type))
            return
        before = transfer.plan.number
        if transfer.take(message, self.send, self.vehicle.wall):
            self._transfer = None
            if transfer.plan.number != before:
                self._done = transfer
                self._stored(transfer.plan, transfer.plan.items)

    def _without_transfer(self, message: Any) -> int:
        """Return what answers an item that nobody has asked for, as MAV_MISSION_RESULT."""
        return mav.MAV_MISSION_ERROR

    def _stored(self, plan: Plan, items: list[Any]) -> None:
        if plan.items is not items:
            plan.replace(items)
        if plan.kind == mav.MAV_MISSION_TYPE_MISSION:
            self.vehicle.flight.mission.changed()
            self.vehicle.params.set("MIS_TOTAL", len(items))
            if self.vehicle.kind.counts_home:
                self.vehicle.send_text(6, "Flight plan received")

    def _mission_list(self, message: Any) -> None:
        client = (message.get_srcSystem(), message.get_srcComponent())
        plan = self._plan(message.mission_type)
        if plan is None:
            refused = mav.MAV_MISSION_UNSUPPORTED
            self.send(mav.MAVLink_mission_ack_message(*client, refused, message.mission_type))
            return
        if self._receives(plan):
            denied = mav.MAV_MISSION_DENIED
            self.send(mav.MAVLink_mission_ack_message(*client, denied, message.mission_type))
            return
        self.send(mav.MAVLink_mission_count_message(*client, self._counted(plan), plan.kind))

    def _receives(self, plan: Plan) -> bool:
        """Return whether a plan is being uploaded, so that an ArduPilot denies a download."""
        return self._transfer is not None and self._transfer.plan is plan

    def _counted(self, plan: Plan) -> int:
        """Return how many items a plan has for a ground station."""
        return len(plan.items)

    def _mission_request(self, message: Any) -> None:
        client = (message.get_srcSystem(), message.get_srcComponent())
        plan = self._plan(message.mission_type)
        if plan is None or message.seq >= len(plan.items):
            wrong = mav.MAV_MISSION_INVALID_SEQUENCE
            self.send(mav.MAVLink_mission_ack_message(*client, wrong, message.mission_type))
            return
        item = plan.items[message.seq]
        x, y, z, frame, command = *item.raw, item.alt, item.frame, item.command
        if plan.kind == mav.MAV_MISSION_TYPE_MISSION and message.seq == 0:
            lat, lon, z = self.vehicle.home or self.vehicle.origin
            x, y, frame, command = round(lat * 1e7), round(lon * 1e7), 0, 16
        current = int(plan.kind == 0 and message.seq == self.vehicle.flight.mission.current)
        parts = (*client, message.seq, frame, command, current, 1, *item.params)
        if message.get_type() == "MISSION_REQUEST_INT":
            self.send(mav.MAVLink_mission_item_int_message(*parts, x, y, z, plan.kind))
        else:
            self.send(mav.MAVLink_mission_item_message(*parts, x / 1e7, y / 1e7, z, plan.kind))

    def _mission_clear(self, message: Any) -> None:
        kinds = range(3) if message.mission_type == 255 else (message.mission_type,)
        for kind in kinds:
            if (plan := self._plan(kind)) is not None:
                self._stored(plan, [])
        client = (message.get_srcSystem(), message.get_srcComponent())
        self.send(
            mav.MAVLink_mission_ack_message(*client, mav.MAV_MISSION_ACCEPTED, message.mission_type)
        )

    def _mission_current(self, message: Any) -> None:
        if self.vehicle.flight.mission.go_to(message.seq):
            self.send(mav.MAVLink_mission_current_message(message.seq))

    # Other messages

    def _streams(self, message: Any) -> None:
        on = bool(message.start_stop)
        self.streams.group(message.req_stream_id, message.req_message_rate, on=on)

    def _origin(self, message: Any) -> None:
        place = (message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1e3)
        self.vehicle.set_origin(place)

    def _timesync(self, message: Any) -> None:
        if message.tc1 == 0:
            now = round(self.vehicle.time * 1e9)
            self.send(mav.MAVLink_timesync_message(now, message.ts1))

    def _setpoint(self, message: Any) -> None:
        setpoints.take(self.vehicle, message)

    def _log_list(self, message: Any) -> None:
        logs = self.vehicle.log.logs
        wanted = [n for n in logs if message.start <= n <= message.end]
        last = max(logs, default=0)
        for number in wanted:
            self.send(mav.MAVLink_log_entry_message(number, len(logs), last, 0, len(logs[number])))
        if not wanted:
            self.send(mav.MAVLink_log_entry_message(0, 0, last, 0, 0))

    def _log_request(self, message: Any) -> None:
        if message.id in self.vehicle.log.logs:
            self._log = (message.id, message.ofs, min(message.ofs + message.count, 2**31))

    def _log_end(self, _: Any) -> None:
        self._log = None

    def _send_log(self) -> None:
        if self._log is None:
            return
        number, at, end = self._log
        data = self.vehicle.log.logs.get(number, b"")
        for _ in range(_LOG_A_TURN):
            piece = bytes(data[at : min(at + _LOG_PIECE, end)])
            padded = list(piece.ljust(_LOG_PIECE, b"\0"))
            self.send(mav.MAVLink_log_data_message(number, at, len(piece), padded))
            at += len(piece)
            if len(piece) < _LOG_PIECE or at >= end:
                self._log = None
                return
        self._log = (number, at, end)
