"""A simulated DroneCAN node: a real node of the library, with a motor, sensors and parameters."""

from __future__ import annotations

import math
import time
from collections import deque
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any

from rcp_can.dronecan.library import make, text_of, transport
from rcp_can.sim.plant import Plant
from rcp_can.sim.twin import Twin

if TYPE_CHECKING:
    import can

__all__ = ["DronecanTwin"]

_library: Any = import_module("dronecan")
_nodes: Any = import_module("dronecan.node")
_RPM = 2 * math.pi / 60
_FULL = 8191
_SILENCE = 0.5  # s without commands after which it stops the motor
_ARMED_FOR = 3.0  # s after an announcement that the system is armed
_BOOTS = 0.5  # s of silence while it boots
_REPORT, _FIX, _CHARGE = 0.05, 0.2, 1.0  # s between two messages
_OPERATIONAL, _ERROR, _OK = 0, 2, 0
_MAGIC = 0xACCE551B1E
_FIX_3D, _RTK, _RTK_FIXED, _UTC = 3, 2, 1, 2


class _Line:
    """The node's driver: frames of the bench."""

    def __init__(self, twin: DronecanTwin) -> None:
        self._twin = twin
        self.received: deque[Any] = deque()

    def receive(self, timeout: float | None = None) -> Any:
        return self.received.popleft() if self.received else None

    def send(self, identifier: int, data: bytes, **_: Any) -> None:
        is_state = identifier >> 8 & 0xFFFF == 341 and not identifier & 0x80
        if not (is_state and self._twin.heartless):
            self._twin.send(identifier, bytes(data), is_extended_id=True)


class DronecanTwin(Twin):
    """One node, which may drive a motor and may have sensors.

    Options are those of the profile, with `index` if it drives a motor, and `sensors` of a node's table.
    """

    def __init__(self, node: int, plant: Plant | None = None, **options: Any) -> None:
        super().__init__(node, plant or Plant(friction=0.01), **options)  # with a propeller
        self.index: int | None = options.get("index")
        self.sensors: tuple[str, ...] = tuple(options.get("sensors", ()))
        self._full: float | None = options.get("full_speed")
        self._reverses: bool = options.get("reverse", False)
        self._arms: bool = options.get("arming", True)
        self._patience: float = options.get("command_timeout") or _SILENCE
        self.parameters: dict[str, Any] = {
            "ESC_INDEX": 0, "GAIN": 0.5, "BEEP": True, "LABEL": "front", "REVISION": 7,
        }  # fmt: skip
        self.fixed = {"REVISION"}
        """Parameters that it does not let anybody change."""
        self.saved = dict(self.parameters)
        self.charge = 81
        self.node_mode = _OPERATIONAL
        """What it tells of itself: whether it is at work, or in maintenance."""
        self.latitude = -35.3632621
        self.healthy = True
        self._armed_until = 0.0
        self._boots_until = 0.0
        self._node: Any
        self._line: _Line
        self._begin()

    def _begin(self) -> None:
        """Begin as after power-on."""
        self._line = _Line(self)
        info = make("protocol.GetNodeInfo.Response", name="org.example.twin")
        info.software_version.major, info.software_version.minor = 1, 4
        info.software_version.vcs_commit, info.software_version.optional_field_flags = 0xC0FFEE, 1
        info.hardware_version.unique_id = [self.node, *range(1, 16)]
        self._node = _nodes.Node(self._line, node_id=self.node, node_info=info, mode=_OPERATIONAL)
        uavcan = _library.uavcan
        for type_, handler in (
            (uavcan.equipment.esc.RPMCommand, self._on_rpm),
            (uavcan.equipment.esc.RawCommand, self._on_raw),
            (uavcan.equipment.safety.ArmingStatus, self._on_arming),
            (uavcan.protocol.param.GetSet, self._on_parameter),
            (uavcan.protocol.param.ExecuteOpcode, self._on_opcode),
            (uavcan.protocol.RestartNode, self._on_restart),
        ):
            self._node.add_handler(type_, handler)

    def boot(self) -> None:
        """Restart: silent for a moment, then with an uptime of zero, and what was saved."""
        super().boot()
        self.healthy = True
        self.parameters = dict(self.saved)
        self._armed_until = 0.0
        self._boots_until = time.monotonic() + _BOOTS
        self._begin()

    def age(self, seconds: float) -> None:
        """Let it have been up for longer."""
        self._node.start_time_monotonic -= seconds

    def break_down(self) -> None:
        """Report an error, and turn nothing until it restarts."""
        super().break_down()
        self.healthy = False

    def take(self, message: can.Message) -> None:
        """Keep a frame for the node, unless it boots."""
        if message.is_extended_id and time.monotonic() >= self._boots_until:
            self._line.received.append(
                _library.driver.CANFrame(message.arbitration_id, bytes(message.data), extended=True)
            )

    def tick(self, now: float) -> None:
        """Let the node work; stop the motor when no command arrives."""
        if now < self._boots_until:
            return
        self._node.health = _OK if self.healthy else _ERROR
        self._node.mode = self.node_mode
        while True:
            with suppress(transport.TransferError):  # a frame of it was lost
                self._node.spin(0)
                break
        if self.is_quiet(self._patience):
            self.plant.off()
        if self.index is not None and not self.blind and self.every("report", _REPORT, now):
            self._report()
        if "gnss" in self.sensors and self.every("fix", _FIX, now):
            self._node.broadcast(self._fix())
        if "battery" in self.sensors and self.every("charge", _CHARGE, now):
            self._node.broadcast(self._battery())

    # The motor

    def _on_rpm(self, event: Any) -> None:
        self._command([rpm * _RPM for rpm in event.message.rpm])

    def _on_raw(self, event: Any) -> None:
        full = self._full or 0.0
        self._command([value / _FULL * full for value in event.message.cmd])

    def _command(self, speeds: list[float]) -> None:
        if self.index is None or self.index >= len(speeds):
            return
        self.feed()
        speed = speeds[self.index]
        if not self._reverses:
            speed = max(0.0, speed)
        if speed and (not self.healthy or not self._is_armed()):
            return
        self.took("velocity", speed)
        self.enabled = speed != 0.0
        if speed:
            self.plant.loop, self.plant.goal = "velocity", speed
        else:
            self.plant.off()

    def _on_arming(self, event: Any) -> None:
        self._armed_until = time.monotonic() + _ARMED_FOR if event.message.status else 0.0
        if not self._is_armed():
            self.plant.off()

    def _is_armed(self) -> bool:
        return not self._arms or time.monotonic() < self._armed_until

    def _report(self) -> None:
        plant = self.plant
        report = make(
            "equipment.esc.Status",
            esc_index=self.index,
            rpm=round(plant.velocity / _RPM),
            voltage=24.0,
            current=plant.torque * 10,
            temperature=plant.temperature + 273.15,
        )
        self._node.broadcast(report)

    # Sensors

    def _fix(self) -> Any:
        fix = make(
            "equipment.gnss.Fix2",
            latitude_deg_1e8=round(self.latitude * 1e8),
            longitude_deg_1e8=round(149.1652374 * 1e8),
            height_msl_mm=584_100,
            sats_used=12,
            status=_FIX_3D,
            mode=_RTK,
            sub_mode=_RTK_FIXED,
            covariance=[0.04, 0.04, 0.09, 0.01, 0.01, 0.01],
            gnss_time_standard=_UTC,
        )
        fix.gnss_timestamp.usec = round(time.time() * 1e6)
        return fix

    def _battery(self) -> Any:
        return make(
            "equipment.power.BatteryInfo",
            state_of_charge_pct=self.charge,
            voltage=22.25,
            current=4.5,
            temperature=300.0,
            status_flags=1,
        )

    # Services

    def _on_parameter(self, event: Any) -> Any:
        request, names = event.request, list(self.parameters)
        name = text_of(request.name)
        if not name and request.index < len(names):
            name = names[request.index]
        response = make("protocol.param.GetSet.Response")
        if name not in self.parameters:
            return response
        kind = transport.get_active_union_field(request.value) or "empty"
        if kind != "empty" and name not in self.fixed:
            value = getattr(request.value, kind)
            self.parameters[name] = _fitting(
                self.parameters[name], text_of(value) if kind == "string_value" else value
            )
        response.name = name
        response.value = _value(self.parameters[name])
        if type(self.parameters[name]) is int:
            response.min_value = make("protocol.param.NumericValue", integer_value=0)
            response.max_value = make("protocol.param.NumericValue", integer_value=19)
        return response

    def _on_opcode(self, event: Any) -> Any:
        if event.request.opcode == 0:
            self.saved = dict(self.parameters)
        return make("protocol.param.ExecuteOpcode.Response", ok=event.request.opcode == 0)

    def _on_restart(self, event: Any) -> Any:
        granted = event.request.magic_number == _MAGIC
        if granted:
            self._boots_until = time.monotonic() + _BOOTS
            self._node.defer(0.0, self.boot)
        return make("protocol.RestartNode.Response", ok=granted)


def _fitting(old: Any, new: Any) -> Any:
    """Return a new value as the node takes it: of its own type, and at most 19."""
    if type(old) is int:
        return max(0, min(19, int(new)))
    return type(old)(new)


def _value(value: Any) -> Any:
    kinds = {bool: "boolean_value", int: "integer_value", float: "real_value", str: "string_value"}
    plain = int(value) if isinstance(value, bool) else value
    return make("protocol.param.Value", **{kinds[type(value)]: plain})
