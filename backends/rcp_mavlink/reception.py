"""From a message of a vehicle to samples: which part of the backend takes which message.

A frame comes from `links.py` and `hub.py` to `vehicle.py`, which keeps the latest of each message
and calls `Reception.frame`. `telemetry.py` publishes most samples, as `sensors.py` and `derived.py`
convert them; what is more than one message has a part of its own here.
"""

from __future__ import annotations

from collections.abc import Callable

from rcp_mavlink.frames import Frame
from rcp_mavlink.measurement import Measurement
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.speed_controllers import SpeedControllers
from rcp_mavlink.stop_plan import GuardPlan
from rcp_mavlink.telemetry import TIMED, Telemetry
from rcp_mavlink.telemetry_events import TelemetryEvents
from rcp_mavlink.terrain import Terrain
from rcp_mavlink.traffic import Traffic
from rcp_mavlink.tree import VehicleTree
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Reception"]

_HEARTBEAT, _PARAM_VALUE, _LOCAL, _GLOBAL, _AUTOPILOT_VERSION, _HOME = 0, 22, 32, 33, 148, 242
_REBOOTED = 10.0  # s by which the vehicle's clock must have gone back


class Reception:
    """The frames of one vehicle; `restarted` is called when its clock has begun anew."""

    def __init__(
        self,
        vehicle: Vehicle,
        tree: VehicleTree,
        measurement: Measurement,
        parameters: Parameters,
        telemetry: Telemetry,
        telemetry_events: TelemetryEvents,
        *,
        traffic: Traffic,
        escs: SpeedControllers,
        terrain: Terrain,
        guard: GuardPlan,
        restarted: Callable[[], None],
    ) -> None:
        self._vehicle, self._tree = vehicle, tree
        self._measurement, self._telemetry = measurement, telemetry
        self._events, self._guard, self._restarted = telemetry_events, guard, restarted
        self._booted = 0  # ms, the last reported time since boot
        self._home: tuple[float, float, float] | None = None
        """The home that the gateway knows as the origin of the map."""
        self._parts: dict[int, Callable[[Frame], None]] = {
            **dict.fromkeys(TelemetryEvents.heeded, telemetry_events.frame),
            **dict.fromkeys(escs.heeded, escs.frame),
            **dict.fromkeys(Traffic.heeded, traffic.frame),
            **terrain.heeded,
            **dict.fromkeys(TIMED, telemetry.timed),
            _HEARTBEAT: self._heartbeat,
            _PARAM_VALUE: parameters.take,
            _LOCAL: self._positioned,
            _GLOBAL: self._positioned,
            _AUTOPILOT_VERSION: self._versioned,
            _HOME: self._homed,
        }

    def frame(self, frame: Frame) -> None:
        """Publish what a frame says, and pass it to the part that needs more of it."""
        self._telemetry.frame(frame)
        part = self._parts.get(frame.definition.id)
        if part is not None:
            part(frame)

    def _heartbeat(self, frame: Frame) -> None:
        self._events.frame(frame)
        self._guard.renew()

    def _positioned(self, frame: Frame) -> None:
        self._measurement.take_position()
        if frame.definition.id == _GLOBAL:
            self._see_reboot(frame)

    def _versioned(self, _: Frame) -> None:
        self._tree.describe(self._vehicle)

    def _homed(self, _: Frame) -> None:
        home = self._vehicle.home
        if home is not None and home != self._home:
            self._home = home
            self._tree.anchor(home)

    def _see_reboot(self, frame: Frame) -> None:
        """Detect a reboot by its clock; a reboot resets the requested rates."""
        clock = int.from_bytes(frame.payload[:4], "little")
        if clock + _REBOOTED * 1000 < self._booted:
            self._events.boot()
            self._telemetry.forget_time()
            self._restarted()  # it may have other firmware
        self._booted = clock
