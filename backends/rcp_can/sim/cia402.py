"""A simulated CiA 402 drive, with the SDO server and NMT slave of canopen."""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING, Any

import canopen

from rcp_can.profiles.cia402_objects import MODES, OBJECTS
from rcp_can.sim.cia402_objects import DEFAULTS, OBJECTS_OF_TWIN, make_dictionary
from rcp_can.sim.plant import Plant
from rcp_can.sim.twin import Twin

if TYPE_CHECKING:
    import can

__all__ = ["Cia402Twin"]

_WORDS = {
    "switch_on_disabled": 0x250,
    "ready": 0x231,
    "switched_on": 0x233,
    "enabled": 0x237,
    "quick_stop": 0x217,
    "fault": 0x218,
}
_PRE_OPERATIONAL = 0x7F
_STORAGE, _NOT_STORED = 0x06060000, 0x08000020  # abort codes of CiA 301
_STANDSTILL = 0.02  # rad/s at which a quick stop ends
_REACHED, _ACKNOWLEDGED, _HOMED, _HOMING_ERROR = 1 << 10, 1 << 12, 1 << 12, 1 << 13
_HERE = frozenset((35, 37))  # homing methods that use the position where it is
_SETTLES = 0.2  # s that they take
_SAVE, _LOAD = b"save", b"load"
_DONE = 0.005  # rad
_LEAST = {0x000: 2, 0x600: 8}
"""Length of NMT and SDO frames, which canopen does not check."""
_OBJECTS = OBJECTS | OBJECTS_OF_TWIN
_CODES = {(index, sub): code for index, sub, code in _OBJECTS.values()}
_WINDOW, _WINDOW_TIME = math.pi / 2, 0.1  # rad and s of following error, after which it is a fault
_BRAKING = 500.0  # rad/s² of a quick stop


class _Line(canopen.Network):
    """canopen's network on the bench's bus, without threads of its own."""

    def __init__(self, twin: Twin) -> None:
        super().__init__()
        self._twin = twin

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:  # noqa: FBT001, FBT002
        if not self._twin.silent:
            self._twin.send(can_id, bytes(data), is_remote_frame=remote)

    def send_periodic(self, can_id: int, data: Any, period: float, remote: bool = False) -> Any:  # noqa: FBT001, FBT002
        return _Never()


class _Never:
    def stop(self) -> None:
        """Do nothing: the twin's own clock sends the heartbeats."""

    def update(self, data: Any) -> None:
        """Do nothing."""


class Cia402Twin(Twin):
    """An axis; options `counts`, `rated_torque` and the scales as in the profile."""

    def __init__(self, node: int, plant: Plant | None = None, **options: Any) -> None:
        super().__init__(node, plant, **options)
        self.scale = options.get("counts", 4096.0) / (2 * math.pi)
        per_second = options.get("velocity_scale", 1.0)
        self.rate_scale = self.scale * per_second
        """Velocity units per rad/s."""
        self.ramp_scale = self.scale * options.get("acceleration_scale", per_second)
        """Acceleration units per rad/s²."""
        self.rated = options.get("rated_torque", 1.0)
        self.state = "switch_on_disabled"
        self.emergency = 0
        self._control = 0
        self._acknowledged = self._homed = False
        self._controlled: int | None = None
        self._homing: str | None = None
        """What it does to home: `search`, `leave`, `settle`; None: nothing."""
        self._homing_error = False
        self._settling = 0.0
        self.switch = -2.0
        """Position of its reference switch, rad."""
        self.stuck = False
        """Its reference switch does not close: homing ends with an error, half a turn behind it."""
        self.storage_fails = False
        """Refuses to store parameters, for a hardware error."""
        self.stores_on_command = True
        """Tells that it stores, or restores, parameters if it is told to."""
        self.stored: dict[int, bytes] = {}
        """What was written to its parameters when they were stored."""
        self._master_seen: float | None = None
        self._astray: float | None = None
        """Since when the following error is too large."""
        self._now = 0.0
        self.keeps_mapping = False
        """Accepts any PDO mapping and reads it back, but keeps its own: statusword only."""
        self.line = _Line(self)
        eds: str = options.get("eds", "")
        dictionary: Any = canopen.import_od(eds, node) if eds else make_dictionary(node)
        self._receives = [index for index in range(0x1400, 0x1440) if index in dictionary]
        self._transmits = [index for index in range(0x1800, 0x1840) if index in dictionary]
        self.local = canopen.LocalNode(node, dictionary)
        self.local.add_write_callback(self._written)
        self.local.add_read_callback(self._read)
        self.line.add_node(self.local)
        self.local.nmt._state = 0x7F  # noqa: SLF001  # booted; `boot` announces it on the bus
        self._hello = True

    # CANopen

    def get(self, name: str) -> int:
        """Return one of the profile's objects as last written."""
        index, sub, code = _OBJECTS[name]
        return struct.unpack("<" + code, self.local.get_data(index, sub))[0]

    def _put(self, index: int, sub: int, value: int) -> None:
        self.local.set_data(index, sub, struct.pack("<" + _CODES[index, sub], value))

    @property
    def operational(self) -> bool:
        """Whether the node is operational, so that PDOs work."""
        return self.local.nmt.state == "OPERATIONAL"

    def boot(self) -> None:
        """Reboot: pre-operational, without PDO mapping."""
        super().boot()
        self.local.data_store.clear()
        self.state, self._control, self.emergency = "switch_on_disabled", 0, 0
        self._acknowledged = self._homed = self._homing_error = False
        self._homing = None
        self._master_seen = None
        self.local.nmt._state = 0x7F  # noqa: SLF001
        self._hello = True

    def option(self, name: str) -> int:
        """Return an option code, or its default if the dictionary has none."""
        index = OBJECTS[name][0]
        if index not in self.local.object_dictionary:
            return DEFAULTS[name]
        return self.get(name)

    def _limit(self, name: str, scale: float, default: float) -> float:
        """Return a limit in rad and s; `default` is that of a drive which nobody has set up."""
        known = _OBJECTS[name][0] in self.local.object_dictionary
        raw = self.get(name) if known else 0
        return raw / scale if raw else default

    def break_down(self) -> None:
        """Go into fault by over-current, with an emergency."""
        super().break_down()
        self._fault(0x2310)

    def _fault(self, code: int) -> None:
        self.state, self.enabled, self.emergency = "fault", False, code
        self.plant.off()
        self.send(0x080 + self.node, struct.pack("<HB5x", code, 0x03))

    def take(self, message: can.Message) -> None:
        """Handle SDO requests, NMT, SYNC, PDOs and the master's heartbeat."""
        identifier = message.arbitration_id
        if (
            message.is_extended_id
            or message.is_remote_frame
            or len(message.data) < _LEAST.get(identifier - self.node if identifier else 0, 0)
        ):
            return
        was = self.local.nmt._state  # noqa: SLF001
        self.line.notify(identifier, bytearray(message.data), message.timestamp)
        if identifier == 0 and was != 0 and self.local.nmt._state == 0:  # noqa: SLF001
            self.boot()
        consumer = self.get_raw(0x1016, 1)
        if consumer and identifier == 0x700 + (consumer >> 16 & 0x7F):
            self._master_seen = self._now
        if identifier == 0x080:
            self._send_pdos(lambda _, kind, __: kind <= 240)
        if self.operational:
            for index in self._receives:
                if identifier == self.get_raw(index, 1):
                    self._command(index, bytes(message.data))

    def get_raw(self, index: int, sub: int) -> int:
        """Return any object as a number."""
        return int.from_bytes(self.local.get_data(index, sub), "little")

    def _mapped(self, index: int) -> list[tuple[int, int, int]]:
        if self.keeps_mapping and index >= 0x1800:
            return [(*OBJECTS["statusword"][:2], 2)] if index == 0x1800 else []
        words = [
            self.get_raw(index + 0x200, n) for n in range(1, 1 + self.get_raw(index + 0x200, 0))
        ]
        return [(word >> 16, word >> 8 & 0xFF, (word & 0xFF) // 8) for word in words]

    def _command(self, index: int, data: bytes) -> None:
        place = 0
        for entry, sub, size in self._mapped(index):
            if place + size <= len(data):
                self.local.set_data(entry, sub, data[place : place + size])
            place += size
        if self._controlled is not None:
            word, self._controlled = self._controlled, None
            self._obey(word)
        self._follow()

    def _written(self, index: int, subindex: int, od: Any, data: bytes) -> None:
        entry = index, subindex
        if index in (0x1010, 0x1011) and subindex:
            self._keep(index, subindex, bytes(data))
        if entry == OBJECTS["controlword"][:2]:
            self._controlled = struct.unpack("<H", data)[0]

    def _keep(self, index: int, subindex: int, signature: bytes) -> None:
        """Store or restore parameters, if the signature is right (CiA 301, 7.5.2.13)."""
        if signature != (_SAVE if index == 0x1010 else _LOAD) or self.storage_fails:
            raise canopen.SdoAbortedError(_STORAGE if self.storage_fails else _NOT_STORED)
        self.stored[index] = signature

    def _read(self, index: int, subindex: int, od: Any) -> int | None:
        entry = index, subindex
        if index in (0x1010, 0x1011) and subindex:
            return int(self.stores_on_command)
        if entry == OBJECTS["statusword"][:2]:
            return self.statusword
        if entry == OBJECTS["mode_shown"][:2]:
            return self.get("mode")
        if entry == OBJECTS["position"][:2]:
            return round(self.plant.position * self.scale)
        if entry == OBJECTS["velocity"][:2]:
            return round(self.plant.velocity * self.rate_scale)
        if entry == OBJECTS["torque"][:2]:
            return round(self.plant.torque / self.rated * 1000)
        if entry == OBJECTS["error_code"][:2]:
            return self.emergency
        return None

    def _send_pdos(self, due: Any) -> None:
        if not self.operational or self.blind:
            return
        for index in self._transmits:
            cob = self.get_raw(index, 1)
            period = self.get_raw(index, 5) / 1000
            if cob >> 31 or not due(index, self.get_raw(index, 2), period):
                continue
            mapped = self._mapped(index)
            if not mapped:
                continue
            parts = (self.local.get_data(entry, sub) for entry, sub, _ in mapped)
            self.send(cob & 0x7FF, b"".join(parts))

    # CiA 402

    @property
    def statusword(self) -> int:
        """The statusword of the current state."""
        word = _WORDS[self.state]
        if self.state != "enabled":
            return word
        mode = self.get("mode")
        if mode == MODES["homing"]:
            if self._homing_error:
                return word | _HOMING_ERROR
            if self._homing is not None:
                return word
            return word | _REACHED | (_HOMED if self._homed else 0)
        if mode == MODES["profile_position"]:
            near = abs(self.plant.goal - self.plant.position) < _DONE
            word |= _REACHED if near and abs(self.plant.velocity) < 0.05 else 0
            return word | (_ACKNOWLEDGED if self._acknowledged else 0)
        return word | _REACHED

    def _obey(self, word: int) -> None:
        old, self._control = self._control, word
        state = self.state
        if state == "fault":
            if word & 0x80 and not old & 0x80:
                self.state, self.emergency = "switch_on_disabled", 0
                self.send(0x080 + self.node, bytes(8))
            return
        if not word & 2:
            new = "switch_on_disabled"
        elif not word & 4:
            new = "quick_stop" if state in ("enabled", "quick_stop") else "switch_on_disabled"
        else:
            new = self._switched(state, word & 0xF)
        if new == "enabled" and self.refuses:
            new = "switched_on"
        self.state = new
        self.enabled = new == "enabled"
        if new == "quick_stop":
            if state != "quick_stop":
                self._stop_quickly()
        elif new != "enabled":
            self.plant.off()
        elif state != "enabled":
            self.plant.hold()
            self.put_targets_to_rest()
        if new == "enabled":
            self._operate(old, word)

    def _stop_quickly(self) -> None:
        """Brake according to 0x605A; 0 does not brake."""
        self.state, self.enabled = "quick_stop", False
        if self.option("quick_stop_option") == 0:
            self.state = "switch_on_disabled"
            self.plant.off()
        else:
            self.plant.hold()
            self.plant.ramp = self._limit("quick_stop_deceleration", self.ramp_scale, _BRAKING)

    @property
    def _torque_offset(self) -> float:
        known = OBJECTS["torque_offset"][0] in self.local.object_dictionary
        return self.get("torque_offset") / 1000 * self.rated if known else 0.0

    def _watch_following(self, now: float) -> None:
        """Go into fault if the position stays too far from its set-point (0x6065, 0x6066)."""
        off = abs(self.plant.goal - self.plant.position)
        follows = self.state == "enabled" and self.get("mode") == MODES["cyclic_position"]
        if not follows or off <= self._limit("following_error_window", self.scale, _WINDOW):
            self._astray = None
        elif self._astray is None:
            self._astray = now
        elif now - self._astray > self._limit("following_error_timeout", 1000, _WINDOW_TIME):
            self._fault(0x8611)

    def _end_quick_stop(self) -> None:
        """Release the motor at rest, unless the option is to stay in quick stop active."""
        resting = abs(self.plant.velocity) < _STANDSTILL
        if self.state == "quick_stop" and resting and self.option("quick_stop_option") < 5:
            self.state = "switch_on_disabled"
            self.plant.off()

    def _miss_master(self) -> None:
        """React to a missing heartbeat: according to 0x6007, and leave operational (0x1029)."""
        self.send(0x080 + self.node, struct.pack("<HB5x", 0x8130, 0x11))
        if 0x1029 not in self.local.object_dictionary or self.get_raw(0x1029, 1) == 0:
            self.local.nmt._state = _PRE_OPERATIONAL  # noqa: SLF001
        if self.state not in ("enabled", "quick_stop"):
            return
        match self.option("abort_connection"):
            case 1:
                self.state, self.enabled, self.emergency = "fault", False, 0x8130
                self.plant.off()
            case 2:
                self.state, self.enabled = "switch_on_disabled", False
                self.plant.off()
            case 3 if self.state == "enabled":
                self._stop_quickly()
            case _:
                return

    def put_targets_to_rest(self) -> None:
        """Discard earlier commands: keep the position, set velocity and torque to zero."""
        self._put(*OBJECTS["target_velocity"][:2], 0)
        self._put(*OBJECTS["target_torque"][:2], 0)

    @staticmethod
    def _switched(state: str, word: int) -> str:
        match word:
            case 0x6:
                return "ready"
            case 0x7:
                return "switched_on" if state in ("ready", "switched_on", "enabled") else state
            case 0xF:
                return "enabled" if state in ("switched_on", "enabled", "quick_stop") else state
            case _:
                return state

    def _operate(self, old: int, word: int) -> None:
        mode, new = self.get("mode"), word & 0x10
        if mode == MODES["profile_position"]:
            if new and not old & 0x10:
                self._acknowledged = True
                self.plant.loop = "position"
                self.plant.goal = self.get("target_position") / self.scale
                self.plant.speed = max(self.get("profile_velocity"), 1) / self.rate_scale
                ramp = self.get("profile_acceleration")
                self.plant.ramp = ramp / self.ramp_scale if ramp else None
                self.took("position", self.plant.goal)
            elif not new:
                self._acknowledged = False
        elif mode == MODES["homing"]:
            if new and not old & 0x10:
                self._start_homing()
            elif not new and self._homing is not None:
                self._homing = None
                self.plant.hold()
        else:
            self._follow()

    def _start_homing(self) -> None:
        """Begin to home; method 0, which is none, is not started (CiA 402-2, table 129)."""
        method = self.get("homing_method")
        self._homed = self._homing_error = False
        if method in _HERE:
            self._homing, self._settling = "settle", _SETTLES
        elif method:
            speed = self.get_raw(0x6099, 1)
            self._homing, self._homing_error = ("search", False) if speed else (None, True)
            self._turn(-speed)

    def _turn(self, speed: float) -> None:
        plant = self.plant
        plant.loop, plant.goal, plant.ramp = "velocity", speed / self.rate_scale, None

    def _home(self, step: float) -> None:
        """Go on homing: search the switch, leave it slowly, and count from there."""
        plant = self.plant
        if self.state != "enabled" or self.get("mode") != MODES["homing"]:
            self._homing = None
        elif self._homing == "search" and plant.position <= self.switch:
            if not self.stuck:
                self._homing = "leave"
                self._turn(self.get_raw(0x6099, 2))
            elif plant.position <= self.switch - math.pi:
                self._homing, self._homing_error = None, True
                plant.hold()
        elif self._homing == "leave" and plant.position > self.switch:
            plant.position -= self.switch
            self.switch = 0.0
            plant.hold()
            self._homing, self._settling = "settle", 0.0
        elif self._homing == "settle":
            self._settling -= step
            if self._settling <= 0 and abs(plant.velocity) < _STANDSTILL:
                if self.get("homing_method") in _HERE:
                    self.switch -= plant.position
                    plant.position = 0.0
                plant.hold()
                self._homing, self._homed = None, True

    def _follow(self) -> None:
        """Apply the set-points of the active mode."""
        if self.state != "enabled":
            return
        plant, mode = self.plant, self.get("mode")
        if mode in (MODES["profile_velocity"], MODES["cyclic_velocity"]):
            self._turn(self.get("target_velocity"))
            self.took("velocity", plant.goal)
        elif mode in (MODES["profile_torque"], MODES["cyclic_torque"]):
            plant.loop, plant.goal = "torque", self.get("target_torque") / 1000 * self.rated
            self.took("torque", plant.goal)
        elif mode == MODES["cyclic_position"]:
            plant.loop, plant.goal = "position", self.get("target_position") / self.scale
            plant.feed = self._torque_offset
            plant.speed, plant.ramp = plant.velocity_limit, None
            self.took("position", plant.goal)

    def tick(self, now: float) -> None:
        """Send boot-up, heartbeat and PDOs; monitor the master; home."""
        self._now = now
        if self._hello:
            self._hello = False
            self.send(0x700 + self.node, b"\0")
        if self._controlled is not None:
            word, self._controlled = self._controlled, None
            self._obey(word)
        period = self.get("heartbeat_period") / 1000
        if period and not self.heartless and self.every("heartbeat", period, now):
            self.send(0x700 + self.node, bytes((self.local.nmt._state,)))  # noqa: SLF001
        self._send_pdos(lambda index, kind, t: kind >= 254 and t and self.every(f"{index}", t, now))
        timeout = (self.get_raw(0x1016, 1) & 0xFFFF) / 1000
        if timeout and self._master_seen is not None and now - self._master_seen > timeout:
            self._master_seen = None  # the master is not monitored until its next heartbeat
            self._miss_master()
        self._end_quick_stop()
        self._watch_following(now)
        if self._homing is not None:
            self._home(0.005)
