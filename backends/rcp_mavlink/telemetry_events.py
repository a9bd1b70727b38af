"""Derived sensors and events: mode, arming, health, status texts, links."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from rcp_mavlink import messages as m
from rcp_mavlink.frames import Frame
from rcp_mavlink.hub import Hub
from rcp_mavlink.texts import SEVERITIES
from rcp_mavlink.vehicle import Text, Vehicle

__all__ = ["TelemetryEvents"]

_FAILSAFES = ("failsafe", "breach", "crash", "ekf variance", "terminat")
_PREARM = ("PreArm: ", "Arm: ", "Preflight Fail: ", "Arming denied: ", "Arming denied! ")
_COMPLAINTS = 35.0  # s for which a reason counts: the vehicle repeats them every 30 s
_SETTLED = 1.5  # s after a reason within which SYS_STATUS may predate it
_RETRY_AFTER = 10.0  # s
_APART = 3.0  # s after which a reason starts a new list
_RECENT = 2.5  # s


class TelemetryEvents:
    """Publishes one vehicle's derived values; `check` makes it report what prevents arming."""

    heeded = frozenset({0, 1, 46})
    """The messages handled here: HEARTBEAT, SYS_STATUS, MISSION_ITEM_REACHED."""

    def __init__(
        self,
        hub: Hub,
        vehicle: Vehicle,
        publish: Callable[[str, Any], None],
        check: Callable[[], None],
    ) -> None:
        self._hub, self._vehicle, self._publish, self._check = hub, vehicle, publish, check
        self._mode = vehicle.mode
        self._armed = vehicle.armed
        self._complaints: list[str] = []
        """Reasons of the latest check: the vehicle reports all of them in sequence."""
        self._complained = self._requested = -math.inf

    def begin(self) -> None:
        """Publish the initial state."""
        self._mode, self._armed = self._vehicle.mode, self._vehicle.armed
        for name in ("sensor/mode", "sensor/armed", "sensor/vehicle"):
            self._publish(name, self.value(name))
        self.links()

    def value(self, name: str) -> Any:
        """Return the present value of a derived path; None if there is none."""
        vehicle = self._vehicle
        match name:
            case "sensor/mode":
                return vehicle.mode
            case "sensor/armed":
                return vehicle.armed
            case "sensor/prearm":
                return self._prearm()
            case "sensor/links":
                return self._links()
            case "sensor/vehicle":
                family: Any = vehicle.family
                modes = list(family.modes.values())
                return m.VehicleInfo(vehicle.system, family.autopilot, family.kind, modes)
            case _:
                return None

    def _prearm(self) -> m.Prearm:
        vehicle = self._vehicle
        ready = vehicle.armed or bool(vehicle.prearm)
        stale = time.monotonic() - self._complained > _COMPLAINTS
        reasons = [] if ready or stale else list(self._complaints)
        return m.Prearm(ready, reasons, vehicle.mode)

    def _health(self) -> None:
        """Clear the reasons once it is ready; request them if it is not and none is known."""
        prearm, now = self._prearm(), time.monotonic()
        if prearm.ready and now - self._complained > _SETTLED:
            self._complaints = []
        unknown = not (prearm.ready or prearm.reasons or self._vehicle.family.px4)
        if unknown and self._vehicle.prearm is False and now - self._requested > _RETRY_AFTER:
            self._requested = now
            self._check()
        self._publish("sensor/prearm", prearm)

    def _complain(self, reason: str, now: float) -> None:
        """Add a reason; a repeated one, or one after a pause, starts a new list."""
        if reason in self._complaints or now - self._complained > _APART:
            self._complaints = []
        self._complaints.append(reason)
        self._complained = now

    def _links(self) -> list[m.LinkState]:
        now, routes = time.monotonic(), self._vehicle.routes.values()
        active = {link.number for link, _, at in routes if now - at < _RECENT}
        found: list[m.LinkState] = []
        for link in self._hub.links:
            s = link.framer.stats
            up = link.number in active
            found.append(
                m.LinkState(
                    link.text,
                    up,
                    s.frames,
                    s.lost,
                    s.bad,
                    s.unknown,
                    s.unsigned,
                    s.rejected,
                    s.sent,
                    s.dropped,
                )
            )
        return found

    def links(self) -> None:
        """Publish the statistics of the links."""
        self._publish("sensor/links", self._links())

    def frame(self, frame: Frame) -> None:
        """Handle a message."""
        match frame.definition.id:
            case 0:
                self._heartbeat()
            case 1:
                self._health()
            case 46:
                first = 1 if self._vehicle.family.px4 else 0  # it counts from 0, without home
                self._publish("event/mission", m.Reached(frame.fields()["seq"] + first))
            case _:
                pass

    def _heartbeat(self) -> None:
        vehicle = self._vehicle
        self._publish("sensor/mode", vehicle.mode)
        self._publish("sensor/armed", vehicle.armed)
        if vehicle.mode != self._mode:
            self._publish("event/mode", m.ModeChange(vehicle.mode, self._mode))
            self._mode = vehicle.mode
        if vehicle.armed != self._armed:
            self._armed = vehicle.armed
            self._publish("event/armed", m.Armed(vehicle.armed, vehicle.mode))

    def text(self, status_text: Text) -> None:
        """Publish a status text, and a separate event if it reports a failsafe."""
        severity = SEVERITIES[min(status_text.severity, len(SEVERITIES) - 1)]
        status = m.StatusText(severity, status_text.text)
        self._publish("event/statustext", status)
        if any(word in status_text.text.lower() for word in _FAILSAFES):
            self._publish("event/failsafe", status)
        start = next((start for start in _PREARM if status_text.text.startswith(start)), None)
        if start is not None:
            self._complain(status_text.text.removeprefix(start), status_text.at)
            self._publish("sensor/prearm", self._prearm())

    def boot(self) -> None:
        """Publish a reboot."""
        self._complaints, self._requested = [], -math.inf
        self._publish("event/boot", m.StatusText("notice", "The vehicle has rebooted."))
