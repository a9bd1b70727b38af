"""Types of the vehicle's commands, and of values derived from several messages."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, defstruct

from rcp_kernel.types import PoseStamped

__all__ = ["Arm", "Armed", "Arrived", "Attitude", "ByCamera", "ByGimbal", "Calibrate", "Calibrated", "Calibrating", "Gimbal", "Height", "Image", "Item", "Items", "LinkState", "MissionProgress", "ModeChange", "MoveTo", "OnItsWay", "ParamValue", "Photo", "Place", "Prearm", "Reached", "ReadParam", "SetItem", "SetMode", "StatusText", "TakeOff", "Underway", "Uploaded", "VehicleInfo", "Velocity", "drive", "velocity"]  # fmt: skip

Latitude = Annotated[float, Meta(ge=-90, le=90, extra_json_schema={"unit": "deg"})]
Longitude = Annotated[float, Meta(ge=-180, le=180, extra_json_schema={"unit": "deg"})]
Over = Annotated[float, Meta(ge=-500, le=10_000, extra_json_schema={"unit": "m"})]
Count = Annotated[int, Meta(extra_json_schema={"unit": "1"})]
Pixels = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "1"})]
Length = Annotated[float, Meta(extra_json_schema={"unit": "m"})]
Left = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "m"})]
Degrees = Annotated[float, Meta(extra_json_schema={"unit": "deg"})]
Level = Annotated[float, Meta(ge=-500, le=20_000, extra_json_schema={"unit": "m"})]
Metres = Annotated[float, Meta(ge=-100_000, le=100_000, extra_json_schema={"unit": "m"})]
Number = Annotated[float, Meta(extra_json_schema={"unit": "1"})]
Speed = Annotated[float, Meta(ge=-100, le=100, extra_json_schema={"unit": "m/s"})]
Angle = Annotated[float, Meta(ge=-6.2832, le=6.2832, extra_json_schema={"unit": "rad"})]


class Arm(Struct, frozen=True, forbid_unknown_fields=True):
    """Options for arming and disarming."""

    force: bool = False
    """Skip the vehicle's own checks; in the air a forced disarm makes it fall."""


class Armed(Struct, frozen=True):
    """Whether the vehicle is armed."""

    armed: bool
    mode: str


class TakeOff(Struct, frozen=True, forbid_unknown_fields=True):
    """Height of a take-off."""

    altitude: Annotated[float, Meta(gt=0, le=500, extra_json_schema={"unit": "m"})] = 10.0
    """Above home, m."""


class Height(Struct, frozen=True):
    """Present height."""

    altitude: Length
    """Above home, m."""


class Place(Struct, frozen=True, forbid_unknown_fields=True):
    """A position in the map, in metres from home."""

    x: Metres
    """East."""
    y: Metres
    """North."""
    z: Over | None = None
    """Above home; default: the present height. A ground vehicle ignores it."""


class MoveTo(Struct, frozen=True, forbid_unknown_fields=True):
    """Target: a position in the map, or latitude and longitude, or metres north and east."""

    position: Place | None = None
    """As in the profiles: x east, y north, z up from home; `yaw` then counts from east."""
    frame: Annotated[str, Meta(min_length=1, max_length=64)] = "map"
    """The frame of `position`: `map`."""
    latitude: Latitude | None = None
    longitude: Longitude | None = None
    north: Metres | None = None
    """From home, m."""
    east: Metres | None = None
    altitude: Over | None = None
    """Above home, m; default: the present height."""
    above: Literal["home", "terrain"] = "home"
    """What `altitude` or `z` counts from: `terrain` is the ground below, which an ArduPilot that knows it
    also follows on the way. Not for ground vehicles."""
    yaw: Angle | None = None
    """Heading; default: free. Counter-clockwise from east with `position`, otherwise clockwise from
    north. Not for ground vehicles or planes."""
    speed: Annotated[float, Meta(gt=0, le=50, extra_json_schema={"unit": "m/s"})] | None = None
    """Ground speed on the way, of a plane its airspeed; default: the autopilot's own."""
    tolerance: Annotated[float, Meta(ge=0.2, le=50, extra_json_schema={"unit": "m"})] | None = None
    """Distance that counts as arrived; default: 1 m, of an aircraft with `position` 0.5 m."""


class OnItsWay(Struct, frozen=True):
    """Remaining distance and present height."""

    distance: Length
    altitude: Length
    """Above home, m."""
    mode: str


class Underway(OnItsWay, frozen=True):
    """Remaining distance and time, and present height."""

    distance_remaining: Left
    """The same as `distance`."""
    eta: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})] | None
    """Time left at the present speed; null while it hardly moves."""


class Arrived(Struct, frozen=True):
    """Where the vehicle arrived."""

    pose: PoseStamped
    latitude: Degrees
    longitude: Degrees
    altitude: Length
    """Above home, m."""
    error: Left
    """Distance from the target, m."""
    speed: Annotated[float, Meta(extra_json_schema={"unit": "m/s"})]
    """Maximum ground speed on the way, m/s."""
    yaw: Annotated[float, Meta(extra_json_schema={"unit": "rad"})] | None
    """Heading, clockwise from north; null if it is not reported."""


class SetMode(Struct, frozen=True, forbid_unknown_fields=True):
    """The flight mode, by the autopilot's own name."""

    mode: Annotated[str, Meta(max_length=32, examples=["GUIDED", "LOITER"])]


class Gimbal(Struct, frozen=True, forbid_unknown_fields=True):
    """Direction of the camera."""

    pitch: Annotated[float, Meta(ge=-1.5708, le=1.5708, extra_json_schema={"unit": "rad"})] = 0.0
    """Positive up."""
    yaw: Annotated[float, Meta(ge=-3.1416, le=3.1416, extra_json_schema={"unit": "rad"})] = 0.0
    """Relative to the vehicle's heading, clockwise."""
    gimbal: Annotated[int, Meta(ge=1, le=255, extra_json_schema={"unit": "1"})] | None = None
    """Device id, as in service/gimbal/list; default: the autopilot's first, or that of the first manager."""
    manager: Annotated[int, Meta(ge=1, le=255, extra_json_schema={"unit": "1"})] | None = None
    """Component id of the manager, where two managers have a gimbal of that id."""


class ByGimbal(Struct, frozen=True, forbid_unknown_fields=True):
    """The gimbal that is meant."""

    gimbal: Annotated[int, Meta(ge=1, le=255, extra_json_schema={"unit": "1"})] | None = None
    """Device id, as in service/gimbal/list; default: what the vehicle takes for its camera's."""
    manager: Annotated[int, Meta(ge=1, le=255, extra_json_schema={"unit": "1"})] | None = None
    """Component id of the manager, where two managers have a gimbal of that id."""


class Calibrate(Struct, frozen=True, forbid_unknown_fields=True):
    """The sensor to calibrate; the vehicle must be still and level."""

    what: Literal[
        "gyro", "barometer", "level", "accelerometer", "accelerometer_full", "compass", "radio"
    ] = "gyro"
    """`accelerometer` only measures it level; `accelerometer_full` takes six positions, and for
    `compass` the vehicle has to be turned; for `radio` the sticks of the remote control are moved."""


class Calibrating(Struct, frozen=True):
    """What the vehicle waits for."""

    text: str
    """What to do now, in words."""
    position: str | None
    """The position to put it in, if it waits for one."""


class ByCamera(Struct, frozen=True, forbid_unknown_fields=True):
    """The camera that is meant."""

    camera: Annotated[int, Meta(ge=1, le=255, extra_json_schema={"unit": "1"})] | None = None
    """Component id, as in service/camera/list; default: the first that takes pictures."""


class Item(Struct, frozen=True, forbid_unknown_fields=True):
    """One item of a mission, a fence or the rally points."""

    command: Annotated[str, Meta(pattern=r"^[A-Z0-9_]{1,64}$", examples=["NAV_WAYPOINT"])]
    """A command of the dialect without `MAV_CMD_`: `NAV_TAKEOFF`, `NAV_WAYPOINT`, `NAV_LAND`."""
    latitude: Latitude = 0.0
    longitude: Longitude = 0.0
    altitude: Level = 0.0
    frame: Literal["relative", "absolute", "terrain", "mission"] = "relative"
    """Reference of the altitude: home, sea or terrain; `mission` if it has no position."""
    params: Annotated[tuple[Number | None, ...], Meta(max_length=4)] = ()
    """The first four parameters of the command; missing ones are 0. Null is `not set`: NaN for
    PX4, which then keeps its heading, and 0 for ArduPilot."""


class Items(Struct, frozen=True, forbid_unknown_fields=True):
    """A whole plan, without home, which the vehicle manages itself."""

    items: Annotated[tuple[Item, ...], Meta(max_length=1000)]


class Uploaded(Struct, frozen=True):
    """The number of items that the vehicle now has."""

    count: Count


class SetItem(Struct, frozen=True, forbid_unknown_fields=True):
    """An item of the mission."""

    item: Annotated[int, Meta(ge=1, le=1000, extra_json_schema={"unit": "1"})]
    """The first is 1."""


class MissionProgress(Struct, frozen=True):
    """Progress of a mission."""

    item: Count
    """The current item; the first is 1."""
    total: Count
    mode: str


class Velocity(Struct, frozen=True, forbid_unknown_fields=True):
    """A velocity in the body frame: x forward, y left, z up; turning left is positive."""

    x: Speed = 0.0
    y: Speed = 0.0
    z: Speed = 0.0
    yaw_rate: Annotated[float, Meta(ge=-2, le=2, extra_json_schema={"unit": "rad/s"})] = 0.0


def velocity(most: float) -> Any:
    """Make the type of a velocity of at most `most` m/s along each axis."""
    speed = Annotated[float, Meta(ge=-most, le=most, extra_json_schema={"unit": "m/s"})]
    fields = [(axis, speed, 0.0) for axis in "xyz"]
    return defstruct("Velocity", fields, bases=(Velocity,), frozen=True, forbid_unknown_fields=True)


class Drive(Struct, frozen=True, forbid_unknown_fields=True):
    """Speed and turning rate; turning left is positive."""

    x: Speed = 0.0
    yaw_rate: Annotated[float, Meta(ge=-2, le=2, extra_json_schema={"unit": "rad/s"})] = 0.0


def drive(most: float) -> Any:
    """Make the type of a ground vehicle's velocity of at most `most` m/s."""
    speed = Annotated[float, Meta(ge=-most, le=most, extra_json_schema={"unit": "m/s"})]
    fields = [("x", speed, 0.0)]
    return defstruct("Drive", fields, bases=(Drive,), frozen=True, forbid_unknown_fields=True)


class Attitude(Struct, frozen=True, forbid_unknown_fields=True):
    """An attitude and the thrust to hold it with."""

    roll: Annotated[float, Meta(ge=-0.7, le=0.7, extra_json_schema={"unit": "rad"})] = 0.0
    """Positive with the right side down."""
    pitch: Annotated[float, Meta(ge=-0.7, le=0.7, extra_json_schema={"unit": "rad"})] = 0.0
    """Positive with the nose up."""
    yaw: Angle | None = None
    """Heading, clockwise from north; default: keep the present heading."""
    thrust: Annotated[float, Meta(ge=0, le=1, extra_json_schema={"unit": "1"})] = 0.5
    """0.5 hovers, or keeps the height."""


class Prearm(Struct, frozen=True):
    """Whether the vehicle can be armed, and the reasons if not."""

    ready: bool
    reasons: list[str]
    mode: str
    """The mode that this applies to: modes that use a position require more."""


class VehicleInfo(Struct, frozen=True):
    """The type and identity of the vehicle."""

    system: Count
    autopilot: Literal["ardupilot", "px4", "unknown"]
    kind: str
    """`copter`, `plane`, `vtol`, `rover`, `boat` or `sub`."""
    modes: list[str]


class LinkState(Struct, frozen=True):
    """Statistics of the links of the backend, since it was opened."""

    link: str
    up: bool
    frames: Count
    lost: Count
    """Gaps in the senders' sequence numbers."""
    bad: Count
    """Damaged bytes and frames."""
    unknown: Count
    unsigned: Count
    """Unsigned frames, if a key is configured."""
    rejected: Count
    """Frames signed with another key, and replayed ones."""
    sent: Count
    dropped: Count
    """Frames that were not sent, as the link was full."""


class StatusText(Struct, frozen=True):
    """A status text of the vehicle."""

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
    """A parameter as stored on the vehicle."""

    name: str
    value: Number


class Image(Struct, frozen=True):
    """A picture as a file."""

    width: Pixels
    height: Pixels
    data: bytes
    format: Literal["jpeg", "png"]


class Photo(Struct, frozen=True):
    """A picture, and where it was taken."""

    number: Count
    latitude: Degrees
    longitude: Degrees
    altitude: Length
    """Above home, m."""
    url: str = ""
    """Where the camera stores it, if it reports that."""
    image: Image | None = None
    """The picture itself, if the camera stores it on board and it is small."""
    note: str = ""
    """Why the picture is not here."""


class Calibrated(Struct, frozen=True):
    """The calibrated sensor, and the vehicle's messages about it."""

    what: str
    texts: list[str]


class Reached(Struct, frozen=True):
    """An item of the mission was reached."""

    item: Count
