"""What is made of several messages, and what happens: mode, arming, health, texts, links."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rcp_mavlink import messages as m
from rcp_mavlink.frames import Frame
from rcp_mavlink.hub import Hub
from rcp_mavlink.texts import SEVERITIES
from rcp_mavlink.vehicle import Text, Vehicle

__all__ = ["Telling"]

_FAILSAFES = ("failsafe", "breach", "crash", "ekf variance", "terminat")
_PREARM = ("PreArm: ", "Arm: ", "Preflight Fail: ", "Arming denied: ", "Arming denied! ")
_COMPLAINTS = 35.0  # s for which a complaint counts: the vehicle repeats them every 30 s
_RECENT = 2.5  # s


class Telling:
    """Publishes what one vehicle's messages mean."""

    heeded = frozenset({0, 1, 46})
    """Messages that change what is told here: HEARTBEAT, SYS_STATUS, MISSION_ITEM_REACHED."""

    def __init__(self, hub: Hub, vehicle: Vehicle, publish: Callable[[str, Any], None]) -> None:
        self._hub, self._vehicle, self._publish = hub, vehicle, publish
        self._mode = vehicle.mode
        self._armed = vehicle.armed

    def begin(self) -> None:
        """Publish what is known at first."""
        self._mode, self._armed = self._vehicle.mode, self._vehicle.armed
        for name in ("sensor/mode", "sensor/armed", "sensor/vehicle"):
            self._publish(name, self.value(name))
        self.links()

    def value(self, name: str) -> Any:
        """Return the present value of a path that is made here; None: there is none."""
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
        since = time.monotonic() - _COMPLAINTS
        reasons: dict[str, None] = {}
        for text in vehicle.texts if not ready else ():
            for start in _PREARM:
                if text.at >= since and text.text.startswith(start):
                    reasons[text.text.removeprefix(start)] = None
        return m.Prearm(ready, list(reasons), vehicle.mode)

    def _links(self) -> list[m.LinkState]:
        now, routes = time.monotonic(), self._vehicle.routes.values()
        heard = {link.number for link, _, at in routes if now - at < _RECENT}
        found: list[m.LinkState] = []
        for link in self._hub.links:
            s = link.framer.stats
            up = link.number in heard
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
                )
            )
        return found

    def links(self) -> None:
        """Publish the statistics of the links."""
        self._publish("sensor/links", self._links())

    def frame(self, frame: Frame) -> None:
        """See what a message changes."""
        match frame.definition.id:
            case 0:
                self._heartbeat()
            case 1:
                self._publish("sensor/prearm", self._prearm())
            case 46:
                reached = frame.fields()["seq"]
                self._publish("event/mission", m.Reached(reached))
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

    def text(self, said: Text) -> None:
        """Publish a text, and as an event of its own where a failsafe acts."""
        severity = SEVERITIES[min(said.severity, len(SEVERITIES) - 1)]
        told = m.Said(severity, said.text)
        self._publish("event/statustext", told)
        if any(word in said.text.lower() for word in _FAILSAFES):
            self._publish("event/failsafe", told)
        if said.text.startswith(_PREARM):
            self._publish("sensor/prearm", self._prearm())

    def boot(self) -> None:
        """Publish that it has begun anew."""
        self._publish("event/boot", m.Said("notice", "The vehicle has started anew."))
