"""The vehicle as a whole: its body, what flies it, what watches over it, and who it talks to."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from rcp_mavlink.geo import offset, shifted
from rcp_mavlink.sim.arming import complaints, mode_complaint
from rcp_mavlink.sim.crafts import body_of, flight_of, pilot_of
from rcp_mavlink.sim.failsafes import Failsafes
from rcp_mavlink.sim.faults import Faults
from rcp_mavlink.sim.fence import Fence
from rcp_mavlink.sim.files import Files
from rcp_mavlink.sim.flightlog import FlightLog
from rcp_mavlink.sim.kinds import KINDS
from rcp_mavlink.sim.modes import Mode, needs_position
from rcp_mavlink.sim.mount import Mount
from rcp_mavlink.sim.noise import Noise
from rcp_mavlink.sim.options import Options
from rcp_mavlink.sim.parameters import Parameters
from rcp_mavlink.sim.plans import Plan
from rcp_mavlink.sim.power import Battery
from rcp_mavlink.sim.sticks import Sticks
from rcp_mavlink.sim.telemetry import MAKERS
from rcp_mavlink.sim.wire import mav

__all__ = ["STEP", "Vehicle"]

STEP = 0.005  # s, of the simulation
_STORM = 60.0  # m/s
_CHATTER = 30.0  # s between two complaints before arming
_WHILE_LANDING = 1 << 3  # of FS_OPTIONS
_FORCE = (21196.0, 2989.0)
_BOOT = (
    (0.05, "EKF3 IMU0 initialised"),
    (0.1, "GPS 1: detected u-blox"),
    (0.3, "EKF3 IMU0 tilt alignment complete"),
    (0.4, "EKF3 IMU0 MAG0 initial yaw alignment complete"),
    (0.95, "EKF3 IMU0 origin set"),
)
"""What is said while it warms up, by the part of that time."""


class Vehicle:
    """One simulated vehicle; `advance` lets time pass, `tell` is where messages go."""

    def __init__(self, options: Options) -> None:
        self.options = options
        self.kind = KINDS[options.vehicle]
        self.tell: list[Callable[[Any], None]] = []
        """Called with each message that goes to everybody."""
        self.params = Parameters(options.vehicle, options.parameters)
        self.noise = Noise(options.seed, options.noise)
        self.wall = 0.0
        """Real seconds, from whatever clock `advance` is given."""
        self.origin = options.home
        self.log = FlightLog()
        self.files = Files(self)
        self.faults = Faults()
        """What a test breaks; stays over a reboot."""
        self._boot(math.radians(options.heading))

    def _boot(self, heading: float) -> None:
        self.time = 0.0
        """Simulated seconds since boot."""
        self.body = body_of(self.kind)
        self.body.yaw = heading
        self.body.wind_n, self.body.wind_e = self.options.wind
        self.pilot = pilot_of(self.kind, self.body)
        self.pilot.yaw = heading
        self.battery = Battery(self.options.capacity, self.options.charge)
        self.home: tuple[float, float, float] | None = None
        self._said: dict[int, Any] = {}
        self.seen_at = (0.0, 0.0)
        """North and east, m, where its position was known last."""
        self.armed = False
        self.armed_for = 0.0
        self.failsafes = Failsafes(self)
        self.sticks = Sticks()
        self.mount = Mount(self)
        self.flight = flight_of(self)
        self.flight.limits()
        self.fence = Fence(self)
        self.rally = Plan(mav.MAV_MISSION_TYPE_RALLY)
        self._told = 0
        self._chattered = 0.0
        self._left = 0.0
        self.rebooted = False

    def reboot(self) -> None:
        """Start anew; what is stored stays."""
        mission, fence, rally = self.flight.mission.plan, self.fence.plan, self.rally
        self._boot(self.body.yaw)
        self.flight.mission.plan, self.fence.plan, self.rally = mission, fence, rally
        self.rebooted = True
        self.say(6, "Calibrating barometer")

    # Where it is

    @property
    def position_ok(self) -> bool:
        """Whether GPS and EKF know where it is."""
        return self.time >= self.options.warmup and bool(self.params["SIM_GPS1_ENABLE"])

    @property
    def gps_ok(self) -> bool:
        """Whether the receiver has a fix."""
        fixed = self.time >= min(5.0, self.options.warmup / 4)
        return fixed and bool(self.params["SIM_GPS1_ENABLE"])

    def geographic(self) -> tuple[float, float]:
        """Return latitude and longitude, deg."""
        return shifted(self.body.n, self.body.e, self.origin[:2])

    def place_of(self, lat: float, lon: float) -> tuple[float, float]:
        """Return north and east of the origin, m."""
        return offset(lat, lon, self.origin[:2])

    def home_place(self) -> tuple[float, float]:
        """Return where home is, m."""
        return (0.0, 0.0) if self.home is None else self.place_of(*self.home[:2])

    def haven(self) -> tuple[float, float]:
        """Return where RTL goes to, m: home, or the nearest rally point that is not farther."""
        n, e = self.body.n, self.body.e
        places = [self.place_of(item.lat, item.lon) for item in self.rally.items]
        most = self.params["RALLY_LIMIT_KM"] * 1000
        near = [place for place in places if most <= 0 or math.dist(place, (n, e)) <= most]
        if self.params["RALLY_INCL_HOME"] or not near:
            near.append(self.home_place())
        return min(near, key=lambda place: math.dist(place, (n, e)))

    # What it says

    def greet(self, send: Callable[[Any], None]) -> None:
        """Say what it is to one who asks."""
        for text in (f"{self.kind.title} V4.7.0-dev (70746572)", self.kind.frame):
            if text:
                send(mav.MAVLink_statustext_message(6, text.encode()))

    def say(self, severity: int, text: str) -> None:
        """Send a STATUSTEXT to everybody."""
        self.broadcast(mav.MAVLink_statustext_message(severity, text.encode()[:50]))

    def broadcast(self, message: Any) -> None:
        """Send a message to everybody."""
        for tell in self.tell:
            tell(message)

    def measure(self, number: int) -> Any:
        """Make a message that tells how it is, by its id; None: there is none now."""
        told = self.faults.telemetry
        if told == "live" or number == mav.MAVLINK_MSG_ID_HEARTBEAT:
            self._said[number] = MAKERS[number](self)
        return None if told == "silent" and number else self._said.get(number)

    # What is done with it

    def set_custom_mode(self, number: int) -> bool:
        """Change the mode to one of a number; tell whether it could be."""
        mode = self.kind.modes.get(number)
        if mode is None:
            self.say(4, f"No such mode {number}")
            return False
        return self.set_mode(mode)

    def set_mode(self, mode: Mode) -> bool:
        """Change the mode; tell whether it could be."""
        if mode is self.flight.mode:
            return True
        if (reason := self.flight.refusal(mode)) is not None:
            self.say(4, reason)
            return False
        self.flight.enter(mode)
        return True

    def arm(self, force: float = 0.0) -> bool:
        """Start the motors; tell whether they may."""
        if self.armed:
            return True
        reasons = [] if force in _FORCE else complaints(self)
        if (wrong := mode_complaint(self)) is not None:
            reasons = [wrong]
        if reasons:
            for reason in reasons:
                self.say(2, f"Arm: {reason}")
            return False
        self.say(6, "Arming motors")
        self.armed, self.armed_for = True, 0.0
        self.pilot.reset()
        if self.position_ok:
            self.set_home(None)
        self.log.begin(self.time)
        return True

    def disarm(self, force: float = 0.0) -> bool:
        """Stop the motors; not in the air, unless forced."""
        if not self.armed:
            return True
        if not self.body.landed and force not in _FORCE:
            return False
        self.say(6, "Disarming motors")
        self.armed = self.pilot.spinning = False
        self.flight.mission.leave()
        self.flight.taking_off = False
        return True

    def set_home(self, place: tuple[float, float, float] | None) -> None:
        """Make a place (deg, deg, m above the sea) home; None: where it is."""
        lat, lon = self.geographic()
        self.home = place or (lat, lon, self.origin[2] - self.body.d)
        self.broadcast(MAKERS[mav.MAVLINK_MSG_ID_HOME_POSITION](self))

    def command(
        self, number: int, params: tuple[float, ...], place: tuple[float, float, float]
    ) -> None:
        """Do what an item of a mission asks for."""
        if number == mav.MAV_CMD_DO_SET_HOME:
            self.set_home(None if params[0] == 1 else place)

    def failsafe(self, why: str, *, return_home: bool, to: Mode | None = None) -> None:
        """Come back, or down where the way back is not known; the real one's words say what.

        `to` is a mode for it, where that can be entered.
        """
        goes_on = self.kind.name != "copter" or int(self.params["FS_OPTIONS"]) & _WHILE_LANDING
        if self.kind.flies and self.body.landed:
            self.say(4, f"{why} Failsafe - Disarming")
            self.disarm()
            return
        if self.kind.flies and self.flight.landing and goes_on:
            self.say(4, f"{why} Failsafe - Continuing Landing")
            return
        self.say(4, f"{why} Failsafe")
        self.retreat(return_home=return_home, to=to)

    def retreat(self, *, return_home: bool, to: Mode | None = None) -> None:
        """Enter the mode of a failsafe, or of a crossed fence."""
        done = Mode.RTL if return_home and self.position_ok else self.kind.down
        if to is not None and self.flight.refusal(to) is None:
            done = to
        if self.flight.mode is not done:
            self.flight.enter(done)

    # Time

    def advance(self, wall: float, real: float) -> None:
        """Let `real` seconds pass, times the speed of the simulation."""
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
        self.log.step(self, dt)

    def _watch_over(self, seconds: float) -> None:
        self._tell_of_boot()
        if self.home is None and self.position_ok:
            self.broadcast(MAKERS[mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN](self))
            self.set_home(None)
            self.say(6, "EKF3 IMU0 is using GPS")
        self.sticks.look(self.wall)
        self.noise.step(seconds)
        self.mount.step(seconds)
        self._blow()
        self.fence.look()
        self.failsafes.look(seconds)
        if not self.armed and self.time - self._chattered > _CHATTER:
            self._chattered = self.time
            for reason in complaints(self):
                self.say(2, f"PreArm: {reason}")

    def _tell_of_boot(self) -> None:
        while self._told < len(_BOOT) and self.time >= _BOOT[self._told][0] * self.options.warmup:
            self.say(6, _BOOT[self._told][1])
            self._told += 1

    def _blow(self) -> None:
        speed = min(_STORM, self.params["SIM_WIND_SPD"])
        if speed > 0:
            away = math.radians(self.params["SIM_WIND_DIR"] + 180)
            self.body.wind_n, self.body.wind_e = speed * math.cos(away), speed * math.sin(away)

    @property
    def ready(self) -> bool:
        """The pre-arm bit; in a mode that flies blind it is up too early, as on the real one."""
        if complaints(self):
            return False
        return not needs_position(self.flight.mode) or self.position_ok
