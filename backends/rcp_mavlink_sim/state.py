"""State shared by all parts of a vehicle: its settings, its body, its position, its messages."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from rcp_mavlink.geo import offset, shifted
from rcp_mavlink_sim.adsb import AdsbReceiver
from rcp_mavlink_sim.crafts import body_of, pilot_of
from rcp_mavlink_sim.faults import Faults
from rcp_mavlink_sim.flight_statistics import FlightStatistics
from rcp_mavlink_sim.follow import Leader
from rcp_mavlink_sim.gnss_corrections import GnssCorrections
from rcp_mavlink_sim.kinds import KINDS
from rcp_mavlink_sim.noise import Noise
from rcp_mavlink_sim.options import Options
from rcp_mavlink_sim.outputs import Outputs
from rcp_mavlink_sim.parameters import Parameters
from rcp_mavlink_sim.plans import Plan
from rcp_mavlink_sim.power import Battery
from rcp_mavlink_sim.sticks import Sticks
from rcp_mavlink_sim.terrain import Place, Terrain
from rcp_mavlink_sim.wire import mav

__all__ = ["VehicleState"]


class VehicleState:
    """The state of one vehicle; `tell` receives its messages."""

    def __init__(self, options: Options) -> None:
        self.options = options
        self.kind = KINDS[options.vehicle]
        self.on_message: list[Callable[[Any], None]] = []
        """Called with each broadcast message."""
        self.params = self.make_parameters(options)
        self.noise = Noise(options.seed, options.noise)
        self.wall = 0.0
        """Real seconds, by the clock of `advance`."""
        self.origin = options.home
        self.faults = Faults()
        """Injected faults; they survive a reboot."""
        self.rally = Plan(mav.MAV_MISSION_TYPE_RALLY)
        self.begin(math.radians(options.heading))

    def make_parameters(self, options: Options) -> Parameters:
        """Return its parameters."""
        return Parameters(options.vehicle, options.parameters)

    def make_leader(self) -> Leader:
        """Return what it follows."""
        return Leader(self.params)

    def begin(self, heading: float) -> None:
        """Start at the origin with the motors off, as after power-on."""
        self.time = 0.0
        """Simulated seconds since boot."""
        self.body = body_of(self.kind)
        self.body.yaw = heading
        self.body.wind_n, self.body.wind_e = self.options.wind
        self.pilot = pilot_of(self.kind, self.body)
        self.pilot.yaw = heading
        self.battery = Battery(self.options.capacity, self.options.charge)
        self.home: tuple[float, float, float] | None = None
        self.seen_at = (0.0, 0.0)
        """The last known position, north and east, m."""
        self.ekf_origin: tuple[float, float, float] | None = None
        """Latitude, longitude (deg) and height (m) of the estimator's origin."""
        self.armed = False
        self.armed_for = 0.0
        self.sticks = Sticks()
        self.outputs = Outputs(self.params, self.send_text)
        self.adsb = AdsbReceiver()
        self.corrections = GnssCorrections()
        self.statistics = FlightStatistics(self.params)
        self.terrain = Terrain(self.params)
        self.leader = self.make_leader()

    # Position

    @property
    def position_ok(self) -> bool:
        """Whether GPS and EKF provide a position."""
        return self.time >= self.options.warmup and bool(self.params["SIM_GPS1_ENABLE"])

    @property
    def gps_ok(self) -> bool:
        """Whether the GPS receiver has a fix."""
        fixed = self.time >= min(5.0, self.options.warmup / 4)
        return fixed and bool(self.params["SIM_GPS1_ENABLE"])

    def geographic(self) -> tuple[float, float]:
        """Return latitude and longitude, deg."""
        return shifted(self.body.n, self.body.e, self.origin[:2])

    def ground_place(self, place: tuple[float, float] | None = None) -> Place:
        """Return a position from the origin, m, as the terrain counts it; by default its own."""
        north, east = place or (self.body.n, self.body.e)
        lat, lon = shifted(north, east, self.origin[:2])
        return round(lat * 1e7), round(lon * 1e7)

    @property
    def ground_home(self) -> Place | None:
        """The position of home, as the terrain counts it."""
        return None if self.home is None else (round(self.home[0] * 1e7), round(self.home[1] * 1e7))

    def above_ground(self, height: float, place: tuple[float, float] | None = None) -> float | None:
        """Return a height above the ground at a position as one above home, m; None if it is not known."""
        return self.terrain.above_home(self.ground_place(place), self.ground_home, height)

    def place_of(self, lat: float, lon: float) -> tuple[float, float]:
        """Return a position relative to the origin, north and east, m."""
        return offset(lat, lon, self.origin[:2])

    def home_place(self) -> tuple[float, float]:
        """Return the position of home, m."""
        return (0.0, 0.0) if self.home is None else self.place_of(*self.home[:2])

    def haven(self) -> tuple[float, float]:
        """Return the target of RTL, m: home, or the nearest rally point that is not farther."""
        n, e = self.body.n, self.body.e
        places = [self.place_of(item.lat, item.lon) for item in self.rally.items]
        most = self.params["RALLY_LIMIT_KM"] * 1000
        near = [place for place in places if most <= 0 or math.dist(place, (n, e)) <= most]
        if self.params["RALLY_INCL_HOME"] or not near:
            near.append(self.home_place())
        return min(near, key=lambda place: math.dist(place, (n, e)))

    def set_home(self, place: tuple[float, float, float] | None) -> None:
        """Set home (deg, deg, m above sea level); None: the present position."""
        lat, lon = self.geographic()
        self.home = place or (lat, lon, self.origin[2] - self.body.d)
        self.broadcast(self.home_position())

    # Messages

    def send_text(self, severity: int, text: str) -> None:
        """Send a STATUSTEXT to everybody."""
        self.broadcast(mav.MAVLink_statustext_message(severity, text.encode()[:50]))

    def broadcast(self, message: Any) -> None:
        """Send a message to everybody."""
        for send in self.on_message:
            send(message)

    def home_position(self) -> Any:
        """Return HOME_POSITION; None if home is not set yet."""
        if self.home is None:
            return None
        n, e = self.home_place()
        lat, lon, height = self.home
        return mav.MAVLink_home_position_message(
            round(lat * 1e7), round(lon * 1e7), round(height * 1000), n, e,
            self.origin[2] - height, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, round(self.time * 1e6),
        )  # fmt: skip

    def set_origin(self, place: tuple[float, float, float]) -> None:
        """Set the estimator's origin and report it; one that is set stays until the next boot."""
        lat, lon, _ = place
        if self.ekf_origin is None and abs(lat) <= 90 and abs(lon) <= 180:
            self.ekf_origin = place
            self.broadcast(self.global_origin())

    def from_origin(self) -> tuple[float, float, float]:
        """Return the estimator's origin: north, east and down from where it was switched on, m."""
        if self.ekf_origin is None:
            return 0.0, 0.0, 0.0
        lat, lon, height = self.ekf_origin
        return (*self.place_of(lat, lon), self.origin[2] - height)

    def global_origin(self) -> Any:
        """Return GPS_GLOBAL_ORIGIN; None before it is set."""
        if self.ekf_origin is None:
            return None
        lat, lon, height = self.ekf_origin
        return mav.MAVLink_gps_global_origin_message(
            round(lat * 1e7), round(lon * 1e7), round(height * 1000), round(self.time * 1e6)
        )
