"""Fault injection: stopped sensors, refusals, delays, lost links and stops, crashes."""

from __future__ import annotations

import math
from collections.abc import Callable

from rcp_sim.messages import FaultSpec

__all__ = ["COMMANDS", "SENSORS", "FaultBoard", "unknown_target"]

SENSORS = (
    "sensor/pose",
    "sensor/velocity",
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
_LINK_BACK = 10.0  # s until a lost link is restored


def unknown_target(spec: FaultSpec) -> str | None:
    """Return why a fault cannot affect its target; None if it can."""
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
    """The active faults. Times are the rover's uptime, s."""

    def __init__(self) -> None:
        self._active: list[tuple[float, FaultSpec]] = []
        self._stops_to_lose = 0
        self.crash = False
        """Whether the rover's loop crashes at its next tick."""

    @property
    def active(self) -> list[FaultSpec]:
        """The active faults."""
        return [spec for _, spec in self._active]

    def inject(self, spec: FaultSpec, now: float) -> None:
        """Activate a fault; it replaces one of the same kind and target."""
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
        """End the faults whose duration has elapsed; return them."""
        if not self._active or all(end > now for end, _ in self._active):
            return []
        over = {id(spec) for end, spec in self._active if end <= now}
        return self._drop(lambda spec: id(spec) in over)

    @property
    def link_lost(self) -> bool:
        """Whether the link is down in both directions."""
        return any(spec.fault == "link_lost" for _, spec in self._active)

    def stopped(self, sensor: str) -> bool:
        """Return whether a sensor is stopped."""
        return self._strikes("sensor_stop", sensor) is not None

    def refused(self, command: str) -> bool:
        """Return whether the rover refuses a command."""
        return self._strikes("refuse", command) is not None

    def delay(self, name: str) -> float:
        """Return the delay of the rover's response, s."""
        spec = self._strikes("slow", name)
        return 0.0 if spec is None else spec.delay

    def lose_stop(self) -> bool:
        """Return whether this stop is lost; each call consumes one."""
        if not self._stops_to_lose:
            return False
        self._stops_to_lose -= 1
        if not self._stops_to_lose:
            self._drop(lambda spec: spec.fault == "stop_lost")
        return True

    def troubles(self) -> str | None:
        """Describe the faults that an operator would notice; None if there are none."""
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
