"""The motion of one vehicle as measured by telemetry, with the age of each measurement."""

from __future__ import annotations

import math
import time

from rcp_kernel.errors import PreconditionFailed
from rcp_kernel.spi import MotionState
from rcp_mavlink.config import MavlinkConfig
from rcp_mavlink.ladder import Rung
from rcp_mavlink.vehicle import Vehicle

__all__ = ["AT_REST", "SETTLED", "Measurement"]

AT_REST = 0.35  # m/s; a copter that holds its position in wind stays below it
_MOVES = 0.5  # m/s above which a vehicle at rest counts as moving again: a gust is not motion
SETTLED = 1.0  # s that it must be still: a braking copter swings back once
_POSITIONS = ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED")
_HEARTBEAT_LATE = 2.5  # s, two periods of a message at 1 Hz
_LANDED_LATE = 2.0  # s, four periods of a message at 2 Hz
_ESTIMATOR_LATE = 5.0  # s after which the last report no longer counts
_VELOCITY_HORIZONTAL, _CONSTANT_POSITION = 2, 128
"""EKF_STATUS_FLAGS: ArduPilot sends zeros or its last estimate while it has no position."""


class Measurement:
    """The motion of one vehicle, from sufficiently recent messages."""

    def __init__(self, vehicle: Vehicle, config: MavlinkConfig) -> None:
        self._vehicle = vehicle
        self._silence = max(config.silence, _HEARTBEAT_LATE)
        self.limit = config.feedback_limit
        """Maximum age of a position, s."""
        self.doubtful_since = -math.inf
        """Earlier messages are ignored: the state may have changed while the vehicle was lost."""
        self._still_since: float | None = None
        self._looked = -math.inf

    def age(self, message: str) -> float:
        """Return the age of the last message of a type, s."""
        received = self._vehicle.received_at.get(message, -math.inf)
        return math.inf if received < self.doubtful_since else time.monotonic() - received

    # State, from heartbeats

    @property
    def has_heartbeat(self) -> bool:
        """Whether its mode and its armed bit are known."""
        vehicle = self._vehicle
        return (
            not vehicle.lost and not vehicle.duplicated and self.age("HEARTBEAT") <= self._silence
        )

    @property
    def disarmed(self) -> bool:
        """Whether it is known to be disarmed."""
        return self.has_heartbeat and not self._vehicle.armed

    @property
    def standing(self) -> bool:
        """Whether it is known to be on the ground."""
        return (
            not self._vehicle.duplicated
            and self._vehicle.landed is True
            and self.age("EXTENDED_SYS_STATE") <= _LANDED_LATE
        )

    # Motion

    def take_position(self) -> None:
        """Update the time since when the positions show it still."""
        at, speed, since = self._measured_at, self.speed, self._still_since
        gap = at - self._looked > self.limit or (since is not None and since < self.doubtful_since)
        settled = since is not None and at - since >= SETTLED
        self._looked = at
        if speed is None or speed >= (_MOVES if settled else AT_REST):
            self._still_since = None
        elif since is None or gap:
            self._still_since = at

    @property
    def still_for(self) -> float:
        """Seconds for which every position was measured still, up to the latest."""
        since = self._still_since
        if since is None or since < self.doubtful_since or self.speed is None:
            return 0.0
        return self._measured_at - since

    @property
    def _measured_at(self) -> float:
        """When the position was measured that tells its speed, on the monotonic clock."""
        for name in _POSITIONS:
            if self.age(name) <= self.limit:
                return self._vehicle.measured_at[name]
        return -math.inf

    @property
    def position_age(self) -> float:
        """Age of the last position, s."""
        return min(map(self.age, _POSITIONS))

    @property
    def estimated(self) -> bool:
        """Whether the autopilot reports a valid velocity estimate."""
        frame = self._vehicle.latest.get("EKF_STATUS_REPORT")
        if frame is None or self.age("EKF_STATUS_REPORT") > _ESTIMATOR_LATE:
            return True
        flags = frame.fields()["flags"]
        return bool(flags & _VELOCITY_HORIZONTAL) and not flags & _CONSTANT_POSITION

    @property
    def speed(self) -> float | None:
        """Total speed, horizontal and vertical, m/s; None if unknown."""
        if not self.estimated:
            return None
        vehicle = self._vehicle
        if self.age("GLOBAL_POSITION_INT") <= self.limit and (fix := vehicle.fix) is not None:
            return fix.speed
        if self.age("LOCAL_POSITION_NED") <= self.limit:
            f = vehicle.latest["LOCAL_POSITION_NED"].fields()
            speed = math.hypot(f["vx"], f["vy"], f["vz"])
            return speed if math.isfinite(speed) else None
        return None

    def unknown(self) -> str:
        """Explain why its speed is unknown."""
        if not self.estimated:
            return "the autopilot has no velocity estimate"
        age = self.position_age
        return "no position received" if math.isinf(age) else f"no position for {age:.1f} s"

    def measured_since(self, moment: float) -> bool:
        """Return whether a position was measured after a moment of the monotonic clock."""
        return self._measured_at > moment

    def stale(self, *, strict: bool = True) -> bool:
        """Return whether its position is too old for motion; `strict` also if it has none."""
        age = self.position_age
        return age > self.limit and (strict or not math.isinf(age))

    @property
    def blind(self) -> bool:
        """Whether messages arrive, but no position for longer than the limit.

        If no messages arrive at all, the link counts as lost, which ends running commands.
        """
        last = max(self._vehicle.received_at.get(name, -math.inf) for name in _POSITIONS)
        return self.stale() and self._vehicle.last_message_at - last >= self.limit

    def check(self, *, strict: bool = True) -> None:
        """Refuse motion without position feedback.

        :raises PreconditionFailed: the position is older than the limit, or may be another vehicle's.
        """
        if self._vehicle.duplicated:
            raise PreconditionFailed(
                self._duplicated(), remedy="Give each vehicle a system id of its own."
            )
        if self.stale(strict=strict):
            raise PreconditionFailed(
                f"{self.unknown()}; at most {self.limit:g} s are allowed",
                remedy="The vehicle is connected but sends no position: check sensor/links and "
                "sensor/ekf. action/land, action/rtl and service/hold are still accepted.",
            )

    def _duplicated(self) -> str:
        return f"two vehicles use the system id {self._vehicle.system}"

    # Rest

    def rest(self, rung: Rung) -> MotionState:
        """Report whether a step of the stop has reached its state."""
        vehicle = self._vehicle
        if vehicle.lost:
            return MotionState(None, f"vehicle {vehicle.system} is not connected")
        if vehicle.duplicated:
            return MotionState(None, self._duplicated())
        if not self.has_heartbeat:
            age = self.age("HEARTBEAT")
            since = "since it returned" if math.isinf(age) else f"for {age:.1f} s"
            return MotionState(None, f"no heartbeat {since}")
        if not vehicle.armed:
            return MotionState(at_rest=True, detail="disarmed", energised=False)
        if self.standing:
            return MotionState(at_rest=True, detail="on the ground, armed", energised=True)
        if rung.rests == "disarmed":
            return MotionState(at_rest=False, detail="armed", energised=True)
        if rung.rests == "landed":
            return MotionState(at_rest=False, detail=self._descent(), energised=True)
        return self._still()

    def _descent(self) -> str:
        fix = self._vehicle.fix
        known = fix is not None and self.age("GLOBAL_POSITION_INT") <= self.limit
        where = f" at {fix.height:.1f} m" if fix is not None and known else ""
        return f"in the air{where} in {self._vehicle.mode}"

    def _still(self) -> MotionState:
        vehicle = self._vehicle
        family, mode, speed = vehicle.family, vehicle.mode, self.speed
        if speed is None:
            return MotionState(None, self.unknown(), energised=True)
        if mode in family.circling(hovering=vehicle.hovering):
            return MotionState(at_rest=True, detail=f"circles in {mode}", energised=True)
        still = self.still_for
        if still < SETTLED:
            moves = "coming to rest" if still else f"moves at {speed:.1f} m/s"
            detail = f"{moves} in {mode}"
            return MotionState(at_rest=False, detail=detail, energised=True)
        if mode not in family.resting:
            return MotionState(at_rest=False, detail=f"free to move in {mode}", energised=True)
        return MotionState(at_rest=True, detail=f"holds in {mode}", energised=True)
