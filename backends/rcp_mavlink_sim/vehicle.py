"""The whole vehicle: its body, its flight, its failsafes and its peers."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, ClassVar

from rcp_mavlink_sim.arming import mode_complaint
from rcp_mavlink_sim.flight import FORCE
from rcp_mavlink_sim.stick_arming import StickArming
from rcp_mavlink_sim.systems import Systems
from rcp_mavlink_sim.telemetry import MAKERS
from rcp_mavlink_sim.wire import mav

__all__ = ["STEP", "Vehicle"]

STEP = 0.005  # s, simulation step
_STORM = 60.0  # m/s
_CHATTER = 30.0  # s between two pre-arm reports
_BOOT = (
    (0.05, "EKF3 IMU0 initialised"),
    (0.1, "GPS 1: detected u-blox"),
    (0.3, "EKF3 IMU0 tilt alignment complete"),
    (0.4, "EKF3 IMU0 MAG0 initial yaw alignment complete"),
    (0.95, "EKF3 IMU0 origin set"),
)
"""Texts during warm-up, by the fraction of its time."""


class Vehicle(Systems):
    """One simulated vehicle; `advance` steps its time, `on_message` receives its messages."""

    makers: ClassVar[dict[int, Any]] = MAKERS
    """Builders of its messages, by id."""
    usual: ClassVar[dict[int, float]] = {mav.MAVLINK_MSG_ID_HEARTBEAT: 1.0}
    """Seconds between two of a message that it sends without a request."""
    boot_texts: ClassVar[tuple[tuple[float, str], ...]] = _BOOT
    ready_text: ClassVar[str] = "EKF3 IMU0 is using GPS"

    def begin(self, heading: float) -> None:
        """Start at the origin with the motors off, as after power-on."""
        super().begin(heading)
        self._last_messages: dict[int, list[Any]] = {}
        self._announced = 0
        self._chattered = 0.0
        self._left = 0.0
        self._stick_arming = StickArming(self)
        self.rebooted = False

    def reboot(self) -> None:
        """Restart; stored data is kept."""
        mission, fence = self.flight.mission.plan, self.fence.plan
        self.leader.release()
        self.params.boot()
        self.begin(self.body.yaw)
        self.flight.mission.plan, self.fence.plan = mission, fence
        self.rebooted = True
        self.send_text(6, "Calibrating barometer")

    # Messages

    def greet(self, send: Callable[[Any], None]) -> None:
        """Send the banner to a peer that requests it."""
        for text in (f"{self.kind.title} V4.7.0-dev (70746572)", self.kind.frame):
            if text:
                send(mav.MAVLink_statustext_message(6, text.encode()))

    def measure(self, number: int) -> list[Any]:
        """Build a telemetry message by its id, one for each gimbal; none if it has no value now."""
        telemetry = self.faults.telemetry
        if telemetry == "live" or number == mav.MAVLINK_MSG_ID_HEARTBEAT:
            made = self.makers[number](self)
            self._last_messages[number] = made if isinstance(made, list) else [made] if made else []
        return [] if telemetry == "silent" and number else self._last_messages.get(number, [])

    # Commands

    def set_custom_mode(self, number: int) -> bool:
        """Change the mode by its number; return whether this succeeded."""
        mode = self.kind.modes.get(number)
        if mode is None:
            self.send_text(4, f"No such mode {number}")
            return False
        return self.flight.set_mode(mode)

    def arm(self, force: float = 0.0) -> bool:
        """Start the motors; return whether this succeeded."""
        if self.armed or self.motor_test.motor:  # a test of motors counts as armed
            return True
        reasons = [] if force in FORCE else self.complaints()
        if (wrong := mode_complaint(self, self.flight)) is not None:
            reasons = [wrong]
        if reasons:
            for reason in reasons:
                self.send_text(2, f"Arm: {reason}")
            return False
        self.begin_armed("Arming motors")
        return True

    def begin_armed(self, text: str) -> None:
        """Start the motors without any check."""
        self.send_text(6, text)
        self.armed, self.armed_for = True, 0.0
        self.pilot.reset()
        if self.position_ok:
            self.set_home(None)
        self.log.begin(self.time)

    # Time

    def advance(self, wall: float, real: float) -> None:
        """Advance by `real` seconds, multiplied by the simulation speed."""
        self.wall = wall
        self._left += real * self.options.speed
        while self._left >= STEP:
            self._left -= STEP
            self._step(STEP)
        if not self.faults.frozen:
            self._watch_over(real * self.options.speed)

    def _step(self, dt: float) -> None:
        self.time += dt
        if self.armed:
            self.armed_for += dt
        if not self.faults.frozen:
            self.flight.step(dt)
            self.pilot.step(dt)
        if self.faults.powerless:
            self.body.cut_power()
        self.body.step(dt)
        self.battery.step(dt, self.body.throttle, armed=self.armed)
        self.log.step(self, self.flight.mode, dt)

    def _watch_over(self, seconds: float) -> None:
        self._announce_boot()
        if self.home is None and self.position_ok:
            self.set_origin(self.origin)
            self.set_home(None)
            self.send_text(6, self.ready_text)
        self.sticks.expire(self.wall)
        self.step_sticks(seconds)
        flying = self.armed and (not self.body.landed or not self.kind.flies)
        self.statistics.step(seconds, flying=flying)
        self.noise.step(seconds)
        for mount in self.mounts:
            mount.step(seconds)
        self.payloads.step(seconds)
        self.motor_test.check()
        self.calibrations.step(seconds)
        self._blow()
        self.fence.check()
        self.failsafes.check(seconds)
        self.step_checks()

    def step_sticks(self, seconds: float) -> None:
        """Arm or disarm as the sticks say."""
        self._stick_arming.step(seconds)
        if self._stick_arming.wanted == "arm" and not self.armed:
            if (wrong := mode_complaint(self, self.flight, by_sticks=True)) is None:
                self.arm()
            else:
                self.send_text(2, f"Arm: {wrong}")
        elif self._stick_arming.wanted == "disarm" and (self.kind.drives or self.body.landed):
            self.flight.disarm()

    def step_checks(self) -> None:
        """Send now and then what prevents arming."""
        if not self.armed and self.time - self._chattered > _CHATTER:
            self._chattered = self.time
            for reason in self.complaints():
                self.send_text(2, f"PreArm: {reason}")

    def _announce_boot(self) -> None:
        while (
            self._announced < len(self.boot_texts)
            and self.time >= self.boot_texts[self._announced][0] * self.options.warmup
        ):
            self.send_text(6, self.boot_texts[self._announced][1])
            self._announced += 1

    def _blow(self) -> None:
        speed = min(_STORM, self.params["SIM_WIND_SPD"])
        if speed > 0:
            away = math.radians(self.params["SIM_WIND_DIR"] + 180)
            self.body.wind_n, self.body.wind_e = speed * math.cos(away), speed * math.sin(away)
