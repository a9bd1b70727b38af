"""The configuration: the broker, and one table per robot."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from msgspec import Meta, Struct, field

__all__ = ["ActionConfig", "FactsheetConfig", "RobotConfig", "VdaConfig"]

_BROKER = re.compile(r"mqtts?://[^/@]+\Z")
_SEGMENT = r"^[^/#+$\s]+$"
_ORIGIN = r"^https?://([A-Za-z0-9.-]+|\[[0-9A-Fa-f:.]+\])(:[0-9]{1,5})?$"
_NAMED = re.compile(r"[A-Za-z0-9_.:-]+\Z")


class ActionConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a VDA 5050 action executes."""

    path: Annotated[str, Meta(pattern=r"^(action|service)/[A-Za-z0-9_./-]+$")]
    """An action or service of the robot: `action/gripper/close`."""
    body: dict[str, Any] | None = None
    """Its input; the parameters of the action are added by their keys."""
    parameters: tuple[str, ...] = ()
    """Keys of parameters that the action accepts; others are refused."""
    description: str = ""


Metres = Annotated[float, Meta(ge=0, extra_json_schema={"unit": "m"})]


class FactsheetConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the factsheet says of the robot; what is not known is 0."""

    series: str = ""
    """Name of the series; default: the serial number."""
    kinematics: Literal["DIFF", "OMNI", "THREEWHEEL"] = "DIFF"
    class_: Literal["FORKLIFT", "CONVEYOR", "TUGGER", "CARRIER"] = field(
        name="class", default="CARRIER"
    )
    localization: tuple[str, ...] = ("NATURAL",)
    length: Metres = 0.0
    width: Metres = 0.0
    height: Metres = 0.0
    max_load: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "kg"})] = 0.0
    max_speed: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "m/s"})] = 0.0
    max_acceleration: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "m/s2"})] = 0.0
    max_deceleration: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "m/s2"})] = 0.0


class RobotConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One robot, as a fleet manager sees it."""

    robot: Annotated[str, Meta(pattern=r"^/tenant/[^/*]+(/[^/*]+)?$")]
    """Its scope: `/tenant/alpha`, or `/tenant/alpha/rover1` where a backend has several."""
    token: str
    """The API key that the fleet manager acts with: its roles decide what it may do."""
    manufacturer: Annotated[str, Meta(pattern=_SEGMENT)]
    serial: str
    """The serial number: letters, digits and `_.:-`."""
    version: Literal["2.1", "3.0"] = "2.1"
    map: Annotated[str, Meta(min_length=1)]
    """The `mapId` of orders."""
    map_version: str = "1"
    """The `mapVersion` that the state names."""
    frame: str = "map"
    """The robot's frame that is this map."""
    start_range: Annotated[float, Meta(gt=0, le=100, extra_json_schema={"unit": "m"})] = 1.0
    """Distance from the first node of an order within which the robot may begin it."""
    tolerance: Annotated[float, Meta(gt=0, le=10, extra_json_schema={"unit": "m"})] | None = None
    """Distance from a node that counts as reached, where an order names none; default: the robot's own."""
    downloads: tuple[Annotated[str, Meta(pattern=_ORIGIN)], ...] = ()
    """Servers from which zone sets may be downloaded: `https://maps.example`; 3.0."""
    factsheet: FactsheetConfig = FactsheetConfig()
    actions: dict[str, ActionConfig] = {}
    """By `actionType`: `pick`, `drop`, `startCharging`."""

    def __post_init__(self) -> None:
        if not _NAMED.match(self.serial):
            raise ValueError(f"`serial`: {self.serial!r} has more than letters, digits and _.:-")
        if self.downloads and self.version != "3.0":
            raise ValueError("`downloads`: zone sets need `version` 3.0")

    @property
    def radius(self) -> float:
        """The radius of a circle around the robot, by its length and width; m."""
        return math.hypot(self.factsheet.length, self.factsheet.width) / 2

    def path(self, name: str) -> str:
        """Return the path of one of the robot's resources."""
        _, _, tenant, *robot = self.robot.split("/")
        branch, _, rest = name.partition("/")
        return "/".join(("", "tenant", tenant, branch, *robot, rest))

    @property
    def tenant(self) -> str:
        """Its tenant."""
        return self.robot.split("/")[2]


class VdaConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The broker, and the robots by name."""

    broker: str = "mqtt://127.0.0.1:1883"
    """`mqtt://HOST:PORT`, or `mqtts://HOST:PORT` with TLS."""
    username: str | None = None
    password: str | None = None
    ca: str | None = None
    """File with the certificates that the broker's may be signed with; default: the system's. Those of
    `downloads` may be signed with either."""
    certificate: str | None = None
    """File with a client certificate and its key."""
    interface: Annotated[str, Meta(pattern=_SEGMENT)] = "uagv"
    """First part of each topic."""
    visualization: Annotated[float, Meta(gt=0, le=10, extra_json_schema={"unit": "Hz"})] = 1.0
    """Rate of position and velocity on the topic `visualization`."""
    robots: dict[str, RobotConfig] = {}

    def __post_init__(self) -> None:
        if not _BROKER.match(self.broker) or not self.host:
            raise ValueError(
                f"`broker`: {self.broker!r} is not mqtt://HOST:PORT or mqtts://HOST:PORT"
            )
        for name in ("ca", "certificate"):
            file = getattr(self, name)
            if file is not None and not Path(file).is_file():
                raise ValueError(f"`{name}`: there is no file {file}")
        serials = [(robot.manufacturer, robot.serial) for robot in self.robots.values()]
        for serial in serials:
            if serials.count(serial) > 1:
                raise ValueError(f"two robots are {' '.join(serial)}")

    @property
    def secure(self) -> bool:
        """Whether the broker is reached by TLS."""
        return self.broker.startswith("mqtts:")

    @property
    def host(self) -> str:
        """The broker's host."""
        return urlsplit(self.broker).hostname or ""

    @property
    def port(self) -> int:
        """The broker's port."""
        return urlsplit(self.broker).port or (8883 if self.secure else 1883)
