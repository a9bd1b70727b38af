"""Two wheels on one axle: kinematics, limits, and commands applied to both wheels or neither."""

from __future__ import annotations

import math
from collections.abc import Callable

from rcp_can.axis import Axis
from rcp_can.config_diff_drive import DiffDriveConfig
from rcp_can.pace import Pace
from rcp_can.preconditions import check, check_link
from rcp_can.wheel_ramp import WheelRamp
from rcp_kernel.errors import ModeForbids, OutOfRange, RcpError
from rcp_kernel.spi import check_fence

__all__ = ["Axle"]

Ended = Callable[[Axis, RcpError], None]
_LATE = 0.1  # s: a longer gap counts as this, so that no wheel jumps


class Axle:
    """The wheels of a differential drive; m/s forward, rad/s to the left (REP-103).

    The commanding owner owns both motors: if one of them loses its set-point, the other is stopped
    in the same call, and the owner is notified which and why.
    """

    def __init__(self, config: DiffDriveConfig, left: Axis, right: Axis) -> None:
        self._config = config
        self.wheels = left, right
        slowest = min(wheel.velocity_limit for wheel in self.wheels)
        self.top_speed = min(config.speed or math.inf, slowest * config.radius)
        """Maximum speed, m/s."""
        self.top_turn = min(
            config.turn_rate or math.inf, 2 * slowest * config.radius / config.track
        )
        """Maximum yaw rate, rad/s."""
        self.speed_limit = self.top_speed
        """The current speed limit, m/s."""
        self._accelerations = [self._acceleration(wheel) for wheel in self.wheels]
        self._owner = ""
        self._ended: Ended | None = None
        self._pace = Pace(_LATE)

    def _acceleration(self, wheel: Axis) -> float | None:
        limits = wheel.config.acceleration, self._config.acceleration
        own, given = limits[0], None if limits[1] is None else limits[1] / self._config.radius
        return min((each for each in (own, given) if each is not None), default=None)

    @property
    def acceleration(self) -> float | None:
        """Acceleration of the drive, m/s²; None: set-points are applied in one step."""
        known = [each for each in self._accelerations if each is not None]
        return min(known) * self._config.radius if known else None

    @property
    def moving(self) -> tuple[float, float] | None:
        """The measured speed and yaw rate; None if a wheel has not reported its velocity."""
        left, right = (wheel.velocity for wheel in self.wheels)
        if left is None or right is None:
            return None
        config = self._config
        return config.radius * (left + right) / 2, config.radius * (right - left) / config.track

    @property
    def owner(self) -> str | None:
        """The resource that currently drives the wheels."""
        return self._owner if self._ended is not None else None

    def _speeds(self, forward: float, turn: float) -> tuple[float, float]:
        half, radius = turn * self._config.track / 2, self._config.radius
        return (forward - half) / radius, (forward + half) / radius

    def limited(self, forward: float, turn: float) -> tuple[float, float]:
        """Return a velocity within the speed limit, on the same curve."""
        part = min(1.0, self.speed_limit / abs(forward)) if forward else 1.0
        return forward * part, turn * part

    def check_range(self, forward: float, turn: float) -> None:
        """Check that the drive and both wheels can reach these speeds.

        :raises OutOfRange: one cannot.
        """
        for what, value, limit, unit in (
            ("linear.x", forward, self._config.speed, "m/s"),
            ("angular.z", turn, self._config.turn_rate, "rad/s"),
        ):
            if limit is not None and abs(value) > limit:
                raise OutOfRange(
                    f"'{what}' exceeds allowed range: {value:g} {unit} is not within "
                    f"-{limit:g} and {limit:g} {unit}",
                    details={"pointer": "/" + what.replace(".", "/")},
                )
        for wheel, speed in zip(self.wheels, self._speeds(forward, turn), strict=True):
            if abs(speed) > wheel.velocity_limit * (1 + 1e-9):
                raise OutOfRange(
                    f"wheel '{wheel.name}' exceeds allowed range: "
                    f"{speed:g} rad/s > {wheel.velocity_limit:g} rad/s"
                )

    def check(self, owner: str) -> None:
        """Check that both wheels can be commanded by `owner`.

        :raises RcpError: as for `preconditions.check`, for the first wheel that cannot.
        :raises ModeForbids: another command drives one of them.
        """
        for wheel in self.wheels:
            if wheel.owner not in (None, owner):
                raise ModeForbids(
                    f"motor '{wheel.name}' is driven by {wheel.owner}",
                    remedy="Cancel that command first.",
                )
            check(wheel)

    def drive(self, forward: float, turn: float, owner: str, ended: Ended) -> None:
        """Command both wheels in one cycle; `ended` is called once if one loses its set-point."""
        check_fence()
        self._owner, self._ended = owner, ended
        goal = self._speeds(forward, turn)
        start = [
            wheel.ramp.velocity if wheel.mode == "velocity" else wheel.velocity or 0.0
            for wheel in self.wheels
        ]
        if any(wheel.mode != "velocity" for wheel in self.wheels):
            self._pace.restart()
        ramp = WheelRamp(start, goal, self._accelerations, self._pace)
        for number, wheel in enumerate(self.wheels):
            wheel.owner, wheel.ended = owner, self._watch(wheel)
            wheel.command("velocity", goal[number], ramp.follow(number))

    def _watch(self, wheel: Axis) -> Callable[[RcpError], None]:
        return lambda reason: self._lose(wheel, reason)

    def _lose(self, lost: Axis, reason: RcpError) -> None:
        """Stop the other wheel; hard, unless the lost one was only commanded to stand still."""
        ended = self._ended
        self.release()
        obeys = lost.status.enabled and lost.online and lost.blind is None and lost.wanted_on
        for wheel in self.wheels:
            if wheel is lost or wheel.stopped or not wheel.online:
                continue
            if not obeys or lost.stopped:
                wheel.stop()
            else:
                wheel.rest()
        if ended is not None:
            ended(lost, reason)

    def release(self) -> None:
        """Release the motors, whatever they are doing."""
        self._ended = None
        for wheel in self.wheels:
            wheel.owner = wheel.ended = None

    def rest(self) -> None:
        """Bring both wheels to rest along one ramp; a wheel that is off or stopped is left alone.

        :raises AdapterUnavailable: a wheel cannot be reached; the other is brought to rest anyway.
        """
        self.release()
        obeying = [w for w in self.wheels if w.status.enabled and not w.stopped]
        if len(obeying) == len(self.wheels):
            self.drive(0.0, 0.0, "", _ignore)
            self.release()
        else:
            for wheel in obeying:
                wheel.command("velocity", 0.0)
        for wheel in self.wheels:
            check_link(wheel)


def _ignore(_wheel: Axis, _reason: RcpError) -> None:
    """Do nothing."""
