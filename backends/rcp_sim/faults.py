"""Faults on request: what a real robot does on a bad day, on the days you choose."""

from __future__ import annotations

import math
from collections.abc import Callable

from rcp_sim.messages import FaultSpec

__all__ = ["COMMANDS", "SENSORS", "FaultBoard", "unknown_target"]

SENSORS = (
    "sensor/pose",
    "sensor/odometry",
    "sensor/imu",
    "sensor/scan",
    "sensor/battery",
    "sensor/camera",
    "sensor/points",
    "sensor/transforms",
    "sensor/joint_states",
    "sensor/map",
)
COMMANDS = (
    "actuator/cmd_vel",
    "param/speed_limit",
    "action/move_to",
    "action/dock",
    "service/reset_system",
    "service/place_obstacle",
    "service/remove_obstacle",
)
_LINK_BACK = 10.0  # s after which a lost link returns by itself


def unknown_target(spec: FaultSpec) -> str | None:
    """Say why the target of a fault does not fit it; None if it does."""
    known: tuple[str, ...] = ()
    match spec.fault:
        case "sensor_stop":
            known = SENSORS
        case "refuse":
            known = COMMANDS
        case "slow":
            known = SENSORS + COMMANDS
        case _:
            pass
    if spec.target is None or spec.target in known:
        return None
    if not known:
        return f"fault '{spec.fault}' has no target"
    return (
        f"fault '{spec.fault}' cannot affect '{spec.target}'; possible targets: {', '.join(known)}"
    )


class FaultBoard:
    """The faults in force. Times are the rover's own uptime in seconds."""

    def __init__(self) -> None:
        self._active: list[tuple[float, FaultSpec]] = []
        self._stops_to_lose = 0
        self.crash = False
        """Whether the rover's loop is to break down at its next tick."""

    @property
    def active(self) -> list[FaultSpec]:
        """What is in force now."""
        return [spec for _, spec in self._active]

    def inject(self, spec: FaultSpec, now: float) -> None:
        """Put a fault in force; one of the same kind and target takes the place of the former."""
        if spec.fault == "crash":
            self.crash = True
            return
        self._drop(lambda old: (old.fault, old.target) == (spec.fault, spec.target))
        if spec.fault == "stop_lost":
            self._stops_to_lose = spec.count
        seconds = spec.seconds
        if seconds is None:
            seconds = _LINK_BACK if spec.fault == "link_lost" else math.inf
        self._active.append((now + seconds, spec))

    def clear(self, fault: str | None = None) -> list[FaultSpec]:
        """End all faults, or those of one kind; return them."""
        return self._drop(lambda spec: fault is None or spec.fault == fault)

    def expire(self, now: float) -> list[FaultSpec]:
        """End what has lasted long enough; return it."""
        if not self._active or all(end > now for end, _ in self._active):
            return []
        over = {id(spec) for end, spec in self._active if end <= now}
        return self._drop(lambda spec: id(spec) in over)

    @property
    def link_lost(self) -> bool:
        """Whether nothing reaches the rover and nothing comes from it."""
        return any(spec.fault == "link_lost" for _, spec in self._active)

    def stopped(self, sensor: str) -> bool:
        """Tell whether a sensor is silent."""
        return self._strikes("sensor_stop", sensor) is not None

    def refused(self, command: str) -> bool:
        """Tell whether the rover refuses a command."""
        return self._strikes("refuse", command) is not None

    def delay(self, name: str) -> float:
        """Return by how many seconds the rover's answer is late."""
        spec = self._strikes("slow", name)
        return 0.0 if spec is None else spec.delay

    def lose_stop(self) -> bool:
        """Tell whether this stop goes missing on its way; each call is one stop."""
        if not self._stops_to_lose:
            return False
        self._stops_to_lose -= 1
        if not self._stops_to_lose:
            self._drop(lambda spec: spec.fault == "stop_lost")
        return True

    def troubles(self) -> str | None:
        """Say what an operator would see of the faults; None: nothing."""
        seen = [
            f"{spec.target or 'every sensor'} has stopped"
            if spec.fault == "sensor_stop"
            else f"{spec.target or 'the rover'} responds {spec.delay} s late"
            for _, spec in self._active
            if spec.fault in ("sensor_stop", "slow")
        ]
        return "; ".join(seen) or None

    def _strikes(self, fault: str, name: str) -> FaultSpec | None:
        for _, spec in self._active:
            if spec.fault == fault and spec.target in (None, name):
                return spec
        return None

    def _drop(self, ended: Callable[[FaultSpec], bool]) -> list[FaultSpec]:
        gone = [spec for _, spec in self._active if ended(spec)]
        if gone:
            self._active = [entry for entry in self._active if not ended(entry[1])]
            if any(spec.fault == "stop_lost" for spec in gone):
                self._stops_to_lose = 0
        return gone
