"""The types of what a vehicle is told, and of what is made of several of its messages."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, defstruct

__all__ = ["Arm", "Armed", "Arrived", "Attitude", "Calibrate", "Calibrated", "Gimbal", "Height", "Item", "Items", "LinkState", "MissionProgress", "ModeChange", "MoveTo", "OnItsWay", "ParamValue", "Photo", "Prearm", "Reached", "ReadParam", "SetMode", "StatusText", "TakeOff", "Uploaded", "VehicleInfo", "Velocity", "drive", "velocity"]  # fmt: skip

Latitude = Annotated[float, Meta(ge=-90, le=90, extra_json_schema={"unit": "deg"})]
Longitude = Annotated[float, Meta(ge=-180, le=180, extra_json_schema={"unit": "deg"})]
Over = Annotated[float, Meta(ge=-500, le=10_000, extra_json_schema={"unit": "m"})]
Count = Annotated[int, Meta(extra_json_schema={"unit": "1"})]
Length = Annotated[float, Meta(extra_json_schema={"unit": "m"})]
Degrees = Annotated[float, Meta(extra_json_schema={"unit": "deg"})]
Level = Annotated[float, Meta(ge=-500, le=20_000, extra_json_schema={"unit": "m"})]
Metres = Annotated[float, Meta(ge=-100_000, le=100_000, extra_json_schema={"unit": "m"})]
Number = Annotated[float, Meta(extra_json_schema={"unit": "1"})]
Speed = Annotated[float, Meta(ge=-100, le=100, extra_json_schema={"unit": "m/s"})]
Angle = Annotated[float, Meta(ge=-6.2832, le=6.2832, extra_json_schema={"unit": "rad"})]


class Arm(Struct, frozen=True, forbid_unknown_fields=True):
    """How to start or stop the motors."""

    force: bool = False
    """Past the vehicle's own checks; in the air a forced disarm lets it fall."""


class Armed(Struct, frozen=True):
    """Whether the vehicle is armed."""

    armed: bool
    mode: str


class TakeOff(Struct, frozen=True, forbid_unknown_fields=True):
    """How high to rise."""

    altitude: Annotated[float, Meta(gt=0, le=500, extra_json_schema={"unit": "m"})] = 10.0
    """Over home, m."""


class Height(Struct, frozen=True):
    """How high it is."""

    altitude: Length
    """Over home, m."""


class MoveTo(Struct, frozen=True, forbid_unknown_fields=True):
    """Where to go: latitude and longitude, or metres from home."""

    latitude: Latitude | None = None
    longitude: Longitude | None = None
    north: Metres | None = None
    """From home, m."""
    east: Metres | None = None
    altitude: Over | None = None
    """Over home, m; as high as it is without it."""
    yaw: Angle | None = None
    """Heading, clockwise from north; it looks where it likes without it. Not for what drives or
    circles."""
    speed: Annotated[float, Meta(gt=0, le=50, extra_json_schema={"unit": "m/s"})] | None = None
    """On the way, over ground; of a plane through the air. The autopilot's own without it."""
    tolerance: Annotated[float, Meta(ge=0.2, le=50, extra_json_schema={"unit": "m"})] = 1.0


class OnItsWay(Struct, frozen=True):
    """How far it still is."""

    distance: Length
    altitude: Length
    """Over home, m."""
    mode: str


class Arrived(Struct, frozen=True):
    """Where it came to."""

    latitude: Degrees
    longitude: Degrees
    altitude: Length
    """Over home, m."""
    error: Length
    """From where it should be, m."""
    speed: Annotated[float, Meta(extra_json_schema={"unit": "m/s"})]
    """The highest over ground on the way, m/s."""
    yaw: Annotated[float, Meta(extra_json_schema={"unit": "rad"})] | None
    """Heading, clockwise from north; null: it does not say."""


class SetMode(Struct, frozen=True, forbid_unknown_fields=True):
    """Which flight mode, by the autopilot's own name."""

    mode: Annotated[str, Meta(max_length=32, examples=["GUIDED", "LOITER"])]


class Gimbal(Struct, frozen=True, forbid_unknown_fields=True):
    """Where the camera should look."""

    pitch: Annotated[float, Meta(ge=-1.5708, le=1.5708, extra_json_schema={"unit": "rad"})] = 0.0
    """Up is positive."""
    yaw: Annotated[float, Meta(ge=-3.1416, le=3.1416, extra_json_schema={"unit": "rad"})] = 0.0
    """From where the vehicle looks, clockwise."""


class Calibrate(Struct, frozen=True, forbid_unknown_fields=True):
    """What to calibrate, while it stands still and level."""

    what: Literal["gyro", "barometer", "level", "accelerometer"] = "gyro"


class Item(Struct, frozen=True, forbid_unknown_fields=True):
    """One item of a mission, a fence or the rally points."""

    command: Annotated[str, Meta(pattern=r"^[A-Z0-9_]{1,64}$", examples=["NAV_WAYPOINT"])]
    """A command of the dialect without `MAV_CMD_`: `NAV_TAKEOFF`, `NAV_WAYPOINT`, `NAV_LAND`."""
    latitude: Latitude = 0.0
    longitude: Longitude = 0.0
    altitude: Level = 0.0
    frame: Literal["relative", "absolute", "terrain", "mission"] = "relative"
    """What the altitude counts from: home, the sea, the ground; `mission` has no place."""
    params: Annotated[tuple[Number, ...], Meta(max_length=4)] = ()
    """The first four parameters of the command; 0 where they are left off."""


class Items(Struct, frozen=True, forbid_unknown_fields=True):
    """A whole plan, without home: that is the vehicle's own."""

    items: Annotated[tuple[Item, ...], Meta(max_length=1000)]


class Uploaded(Struct, frozen=True):
    """How many items the vehicle has now."""

    count: Count


class MissionProgress(Struct, frozen=True):
    """How far a mission is."""

    item: Count
    """The one it flies now; the first is 1."""
    total: Count
    mode: str


class Velocity(Struct, frozen=True, forbid_unknown_fields=True):
    """A velocity in the vehicle's own axes: x forward, y left, z up; turning left is positive."""

    x: Speed = 0.0
    y: Speed = 0.0
    z: Speed = 0.0
    yaw_rate: Annotated[float, Meta(ge=-2, le=2, extra_json_schema={"unit": "rad/s"})] = 0.0


def velocity(most: float) -> Any:
    """Make the type of a velocity of at most so many m/s along each axis."""
    speed = Annotated[float, Meta(ge=-most, le=most, extra_json_schema={"unit": "m/s"})]
    fields = [(axis, speed, 0.0) for axis in "xyz"]
    return defstruct("Velocity", fields, bases=(Velocity,), frozen=True, forbid_unknown_fields=True)


class Drive(Struct, frozen=True, forbid_unknown_fields=True):
    """How fast to drive and to turn; turning left is positive."""

    x: Speed = 0.0
    yaw_rate: Annotated[float, Meta(ge=-2, le=2, extra_json_schema={"unit": "rad/s"})] = 0.0


def drive(most: float) -> Any:
    """Make the type of what drives at most so many m/s."""
    speed = Annotated[float, Meta(ge=-most, le=most, extra_json_schema={"unit": "m/s"})]
    fields = [("x", speed, 0.0)]
    return defstruct("Drive", fields, bases=(Drive,), frozen=True, forbid_unknown_fields=True)


class Attitude(Struct, frozen=True, forbid_unknown_fields=True):
    """An attitude and the thrust to hold it with."""

    roll: Annotated[float, Meta(ge=-0.7, le=0.7, extra_json_schema={"unit": "rad"})] = 0.0
    """Right side down is positive."""
    pitch: Annotated[float, Meta(ge=-0.7, le=0.7, extra_json_schema={"unit": "rad"})] = 0.0
    """Nose up is positive."""
    yaw: Angle | None = None
    """Heading, clockwise from north; without it the vehicle keeps the heading that it has."""
    thrust: Annotated[float, Meta(ge=0, le=1, extra_json_schema={"unit": "1"})] = 0.5
    """0.5 is hovering, or keeping the height."""


class Prearm(Struct, frozen=True):
    """Whether the vehicle would let itself be armed, and what it complains of."""

    ready: bool
    reasons: list[str]
    mode: str
    """The answer is for this mode: a mode that flies by position asks for more."""


class VehicleInfo(Struct, frozen=True):
    """What is behind the link."""

    system: Count
    autopilot: Literal["ardupilot", "px4", "unknown"]
    kind: str
    """`copter`, `plane`, `vtol`, `rover`, `boat` or `sub`."""
    modes: list[str]


class LinkState(Struct, frozen=True):
    """What came and went over the links of the backend, since it was opened."""

    link: str
    up: bool
    frames: Count
    lost: Count
    """Missing in the senders' counts."""
    bad: Count
    """Bytes and frames that were damaged."""
    unknown: Count
    unsigned: Count
    """Not signed, where there is a key."""
    rejected: Count
    """Signed with another key, or come a second time."""
    sent: Count


class StatusText(Struct, frozen=True):
    """What the vehicle said in words."""

    severity: str
    text: str


class ModeChange(Struct, frozen=True):
    """A change of the flight mode."""

    mode: str
    was: str


class ReadParam(Struct, frozen=True, forbid_unknown_fields=True):
    """The name of a parameter."""

    name: Annotated[str, Meta(pattern=r"^[A-Za-z0-9_]{1,16}$", examples=["RTL_ALT"])]


class ParamValue(Struct, frozen=True):
    """A parameter as it is on the vehicle."""

    name: str
    value: Number


class Photo(Struct, frozen=True):
    """A picture that was taken, and where."""

    number: Count
    latitude: Degrees
    longitude: Degrees
    altitude: Length
    """Over home, m."""
    url: str = ""
    """Where the camera has it, if it says so."""


class Calibrated(Struct, frozen=True):
    """What was calibrated, and what the vehicle said of it."""

    what: str
    texts: list[str]


class Reached(Struct, frozen=True):
    """An item of the mission was reached."""

    item: Count
