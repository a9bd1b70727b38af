"""The vehicle as a whole: its body, what flies it, what watches over it, and who it talks to."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from rcp_mavlink.geo import offset, shifted
from rcp_mavlink.sim.arming import complaints, mode_complaint
from rcp_mavlink.sim.body import Body
from rcp_mavlink.sim.fence import Fence
from rcp_mavlink.sim.flight import Flight
from rcp_mavlink.sim.flightlog import FlightLog
from rcp_mavlink.sim.modes import Mode, needs_position
from rcp_mavlink.sim.options import Options
from rcp_mavlink.sim.parameters import Parameters
from rcp_mavlink.sim.pilot import Pilot
from rcp_mavlink.sim.plans import Plan
from rcp_mavlink.sim.power import Battery
from rcp_mavlink.sim.telemetry import MAKERS
from rcp_mavlink.sim.wire import mav

__all__ = ["STEP", "Vehicle"]

STEP = 0.005  # s, of the simulation
_CHATTER = 30.0  # s between two complaints before arming
_FORCE = (21196.0, 2989.0)


class Vehicle:
    """One simulated copter; `advance` lets time pass, `tell` is where messages go."""

    def __init__(self, options: Options) -> None:
        self.options = options
        self.tell: list[Callable[[Any], None]] = []
        """Called with each message that goes to everybody."""
        self.params = Parameters(options.parameters)
        self.wall = 0.0
        """Real seconds, from whatever clock `advance` is given."""
        self.origin = options.home
        self.log = FlightLog()
        self._heard = 0.0
        self._boot(math.radians(options.heading))

    def _boot(self, heading: float) -> None:
        self.time = 0.0
        """Simulated seconds since boot."""
        self.body = Body()
        self.body.yaw = heading
        self.body.wind_n, self.body.wind_e = self.options.wind
        self.pilot = Pilot(self.body)
        self.pilot.yaw = heading
        self.battery = Battery(self.options.capacity, self.options.charge)
        self.home: tuple[float, float, float] | None = None
        self.armed = False
        self.armed_for = 0.0
        self.battery_low = self.station_lost = False
        self.station_seen = False
        self.gimbal = (0.0, 0.0, 0.0)
        """Roll, pitch, yaw of the camera's mount, deg."""
        self.photos = 0
        self.flight = Flight(self)
        self.fence = Fence(self)
        self.rally = Plan(mav.MAV_MISSION_TYPE_RALLY)
        self._low_for = 0.0
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
        return self.time >= self.options.warmup

    def geographic(self) -> tuple[float, float]:
        """Return latitude and longitude, deg."""
        return shifted(self.body.n, self.body.e, self.origin[:2])

    def place_of(self, lat: float, lon: float) -> tuple[float, float]:
        """Return north and east of the origin, m."""
        return offset(lat, lon, self.origin[:2])

    def home_place(self) -> tuple[float, float]:
        """Return where home is, m."""
        return (0.0, 0.0) if self.home is None else self.place_of(*self.home[:2])

    # What it says

    def say(self, severity: int, text: str) -> None:
        """Send a STATUSTEXT to everybody."""
        self.broadcast(mav.MAVLink_statustext_message(severity, text.encode()[:50]))

    def broadcast(self, message: Any) -> None:
        """Send a message to everybody."""
        for tell in self.tell:
            tell(message)

    # What is done with it

    def set_mode(self, number: int) -> bool:
        """Change the mode; tell whether it could be."""
        try:
            mode = Mode(number)
        except ValueError:
            self.say(4, f"No such mode {number}")
            return False
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

    def failsafe(self, why: str, *, return_home: bool) -> None:
        """Come back, or down where the way back is not known."""
        landing = self.flight.mode in (Mode.LAND, Mode.RTL)
        if self.body.landed:
            self.disarm()
        elif not landing:
            mode = Mode.RTL if return_home and self.position_ok else Mode.LAND
            self.say(4, f"{why.title()} Failsafe: {mode.name}")
            self.flight.enter(mode)

    def heard_from_station(self) -> None:
        """Note a heartbeat of the ground station that it obeys."""
        self._heard, self.station_seen = self.wall, True
        if self.station_lost:
            self.station_lost = False
            self.say(4, "GCS Failsafe Cleared")

    # Time

    def advance(self, wall: float, real: float) -> None:
        """Let `real` seconds pass, times the speed of the simulation."""
        self.wall = wall
        self._left += real * self.options.speed
        while self._left >= STEP:
            self._left -= STEP
            self._step(STEP)
        self._watch_over(real * self.options.speed)

    def _step(self, dt: float) -> None:
        self.time += dt
        if self.armed:
            self.armed_for += dt
        self.flight.step(dt)
        self.pilot.step(dt)
        self.body.step(dt)
        self.battery.step(dt, self.body.throttle, armed=self.armed)
        self.log.step(self, dt)

    def _watch_over(self, seconds: float) -> None:
        if self.home is None and self.position_ok:
            self.broadcast(MAKERS[mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN](self))
            self.set_home(None)
            self.say(6, "EKF3 IMU0 is using GPS")
        self.fence.look()
        self._watch_battery(seconds)
        self._watch_station()
        if not self.armed and self.time - self._chattered > _CHATTER:
            self._chattered = self.time
            for reason in complaints(self):
                self.say(2, f"PreArm: {reason}")

    def _watch_battery(self, seconds: float) -> None:
        p, volts = self.params, self.battery.voltage
        low = volts < p["BATT_LOW_VOLT"] or (
            p["BATT_LOW_MAH"] > 0 and self.battery.consumed > p["BATT_CAPACITY"] - p["BATT_LOW_MAH"]
        )
        self._low_for = self._low_for + seconds if low else 0.0
        if self.battery_low or self._low_for < p["BATT_LOW_TIMER"]:
            return
        self.battery_low = True
        self.say(4, f"Battery 1 is low {volts:.2f}V used {self.battery.consumed:.0f} mAh")
        if self.armed and p["BATT_FS_LOW_ACT"]:
            self.failsafe("BATTERY", return_home=p["BATT_FS_LOW_ACT"] != 1)

    def _watch_station(self) -> None:
        p = self.params
        late = self.wall - self._heard > p["FS_GCS_TIMEOUT"]
        if self.station_lost or not (self.station_seen and late and p["FS_GCS_ENABLE"]):
            return
        self.station_lost = True
        self.say(4, "GCS Failsafe")
        if self.armed:
            self.failsafe("GCS", return_home=p["FS_GCS_ENABLE"] != 5)

    @property
    def ready(self) -> bool:
        """The pre-arm bit; in a mode that flies blind it is up too early, as on the real one."""
        if complaints(self):
            return False
        return not needs_position(self.flight.mode) or self.position_ok
