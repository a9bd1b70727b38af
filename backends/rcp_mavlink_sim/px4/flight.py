"""PX4's modes: HOLD goes to targets, OFFBOARD follows set-points as long as they come."""

from __future__ import annotations

import math

from rcp_mavlink_sim.flight import FORCE, Submode
from rcp_mavlink_sim.flights.copter import CopterFlight
from rcp_mavlink_sim.modes import Mode, needs_position
from rcp_mavlink_sim.state import VehicleState

__all__ = ["HOLD", "Px4Flight"]

HOLD = Mode.GUIDED
"""The flight's own name for the mode that holds a position, or goes to one."""
_SLOWEST = 0.5  # s between two set-points: 2 Hz
_PROOF = 0.4  # s of set-points before OFFBOARD
_FAILSAFES = {
    0: Mode.LOITER,
    1: Mode.ALT_HOLD,
    2: Mode.STABILIZE,
    3: Mode.RTL,
    4: Mode.LAND,
    5: HOLD,
}
"""By COM_OBL_RC_ACT."""
_WORDS = {
    HOLD: "Hold", Mode.AUTO: "Mission", Mode.RTL: "Return", Mode.LAND: "Land", Mode.TAKEOFF: "Takeoff",
    Mode.OFFBOARD: "Offboard", Mode.FOLLOW: "Follow Target", Mode.CIRCLE: "Orbit", Mode.LOITER: "Position",
}  # fmt: skip


class Px4Flight(CopterFlight):
    """The flight of a copter with PX4."""

    led = Mode.OFFBOARD
    starts_itself = True
    paced = frozenset({HOLD, Mode.AUTO, Mode.RTL})

    def __init__(self, vehicle: VehicleState) -> None:
        super().__init__(vehicle)
        self._heard = self._since = -math.inf
        self._climb = 0.0

    @property
    def follows_at_most(self) -> float:
        """The speed that FOLLOW does not exceed, m/s."""
        return self._vehicle.params["MPC_XY_VEL_MAX"]

    # Set-points

    def hear(self) -> None:
        """Note that a set-point has come, in any mode."""
        now = self._vehicle.wall
        if now - self._heard > _SLOWEST:
            self._since = now
        self._heard = now

    @property
    def _offered(self) -> bool:
        """Whether set-points have come for long enough, at two a second or more."""
        late = self._vehicle.wall - self._heard > _SLOWEST
        return not late and self._heard - self._since >= _PROOF

    def follow(self, submode: Submode) -> None:
        """Activate a set-point: it counts until the next one, or until they cease."""
        super().follow(submode)
        self._setpoint_ends = None

    # Modes

    def refusal(self, mode: Mode) -> str | None:
        """Return why a mode cannot be entered now; None if it can."""
        vehicle = self._vehicle
        blind = needs_position(mode) and not vehicle.position_ok
        empty = mode is Mode.AUTO and not self.mission.flyable
        if blind or empty or (mode is Mode.OFFBOARD and not self._offered):
            return f"Switching to mode '{_WORDS.get(mode, mode.name)}' is currently not available"
        return None

    def enter(self, mode: Mode) -> None:
        """Enter a mode; TAKEOFF climbs as soon as it is armed."""
        super().enter(mode)
        self._speeds.clear()
        self.tune()

    def take_off(self, height: float) -> bool:
        """Enter TAKEOFF, to climb to a height above home, m; return whether this is possible."""
        if not math.isfinite(height) or not self.set_mode(Mode.TAKEOFF):
            return False
        self._climb = height
        if self._vehicle.armed:
            self._rise()
        return True

    def _rise(self) -> None:
        self.lift(max(self._climb, -self._vehicle.body.d))

    def reposition(
        self, place: tuple[float, float] | None, depth: float | None, speed: float, yaw: float
    ) -> None:
        """Go to a place in HOLD, or stop where it is; NaN keeps the heading, a speed of -1 the usual one."""
        pilot = self._vehicle.pilot
        if place is None and depth is None:
            pilot.hold()
        self.aim(place, depth)
        pilot.faces_travel = False
        if speed > 0:
            self._speeds["speed"] = min(speed, self._vehicle.params["MPC_XY_VEL_MAX"])
        else:
            self._speeds.pop("speed", None)
        self.tune()
        if math.isfinite(yaw):
            pilot.yaw, pilot.yaw_rate = yaw, 0.0

    def orbit(
        self, centre: tuple[float, float], radius: float, speed: float, depth: float | None
    ) -> bool:
        """Go round a place; a negative radius is anticlockwise. Return whether this is possible now."""
        vehicle = self._vehicle
        if not vehicle.armed or vehicle.body.landed or not self.set_mode(Mode.CIRCLE):
            return False
        vehicle.params.set("CIRCLE_RADIUS", abs(radius) * 100)
        vehicle.params.set("CIRCLE_RATE", math.degrees(abs(speed) / radius))
        body = vehicle.body
        self._centre = centre
        self._angle = math.atan2(body.e - centre[1], body.n - centre[0])
        if depth is not None:
            vehicle.pilot.depth = depth
        return True

    def disarm(self, force: float = 0.0) -> bool:
        """Stop the motors; refused in the air, unless forced."""
        vehicle = self._vehicle
        if vehicle.armed and not vehicle.body.landed and force not in FORCE:
            vehicle.send_text(2, "Disarming denied: not landed")
            return False
        return super().disarm(force)

    def lead(self, dt: float) -> None:
        """Control the pilot for `dt` seconds in any mode except MISSION."""
        if self.mode is Mode.TAKEOFF:
            if not self.taking_off and self._vehicle.body.landed:
                self._rise()
            elif self.risen():
                self.enter(HOLD)
        elif self.mode is Mode.OFFBOARD:
            self._watch()
        else:
            super().lead(dt)

    def _watch(self) -> None:
        vehicle = self._vehicle
        if vehicle.wall - self._heard <= vehicle.params["COM_OF_LOSS_T"]:
            return
        to = _FAILSAFES.get(int(vehicle.params["COM_OBL_RC_ACT"]), HOLD)
        vehicle.send_text(2, "Failsafe activated: No offboard signal")
        self.enter(to if super().refusal(to) is None else Mode.LAND)

    def finished(self) -> None:
        """Hold at the end of a mission."""
        self._vehicle.send_text(6, "Mission finished, loitering")
        self.enter(HOLD)
