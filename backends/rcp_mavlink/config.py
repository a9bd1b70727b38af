"""The configuration of one MAVLink backend: links, vehicles and time-outs."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from msgspec import Meta, Struct

__all__ = ["LinkSpec", "MavlinkConfig", "TwinBox", "TwinConfig"]

_NET = re.compile(r"(udpin|udpout|tcp|tcpin):(?:\[([^\]]+)\]|([^:\[\]]+)):(\d{1,5})\Z")
_SIM = re.compile(r"sim:(copter|plane|rover|boat|px4)\Z")
_SERIAL = re.compile(r"serial:(/[^:]+)(?::(\d+))?\Z")
_SEGMENT = re.compile(r"[A-Za-z0-9_.-]+\Z")

Seconds = Annotated[float, Meta(gt=0, le=600, extra_json_schema={"unit": "s"})]
SystemId = Annotated[int, Meta(ge=1, le=255)]


class LinkSpec(Struct, frozen=True):
    """One link as configured: `udpin:127.0.0.1:14550`, `serial:/dev/ttyACM0:115200`."""

    kind: str
    host: str
    """Or the device, or the type of the simulated vehicle."""
    port: int
    """Or the baud rate."""

    @classmethod
    def of(cls, text: str) -> LinkSpec:
        """Parse a link.

        :raises ValueError: the text is not a valid link.
        """
        if (net := _NET.match(text)) is not None and int(net[4]) < 65536:
            return cls(net[1], net[2] or net[3], int(net[4]))
        if (serial := _SERIAL.match(text)) is not None:
            return cls("serial", serial[1], int(serial[2] or 57600))
        if (sim := _SIM.match(text)) is not None:
            return cls("sim", sim[1], 0)
        raise ValueError(
            f"{text!r} is not a link: use udpin, udpout, tcp or tcpin with host and port, "
            "serial:DEVICE:BAUD, or sim:copter, plane, rover, boat or px4"
        )


class TwinBox(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A square box that stands on the ground, in the pictures of the simulated cameras."""

    latitude: Annotated[float, Meta(ge=-90, le=90, extra_json_schema={"unit": "deg"})]
    longitude: Annotated[float, Meta(ge=-180, le=180, extra_json_schema={"unit": "deg"})]
    side: Annotated[float, Meta(gt=0, le=1000, extra_json_schema={"unit": "m"})] = 1.0
    height: Annotated[float, Meta(gt=0, le=1000, extra_json_schema={"unit": "m"})] = 1.0


class TwinConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The vehicles that `sim:` links simulate."""

    home: tuple[
        Annotated[float, Meta(ge=-90, le=90, extra_json_schema={"unit": "deg"})],
        Annotated[float, Meta(ge=-180, le=180, extra_json_schema={"unit": "deg"})],
        Annotated[float, Meta(extra_json_schema={"unit": "m"})],
    ] = (-35.3632621, 149.1652374, 584.0)
    """Latitude, longitude and height above sea level of the first vehicle."""
    heading: Annotated[float, Meta(ge=-360, le=360, extra_json_schema={"unit": "deg"})] = 0.0
    warmup: Annotated[float, Meta(ge=0, le=600, extra_json_schema={"unit": "s"})] = 40.0
    """Time from boot until it can be armed in a mode that requires a position."""
    speed: Annotated[float, Meta(gt=0, le=50, extra_json_schema={"unit": "1"})] = 1.0
    """Simulated seconds per real second."""
    wind: tuple[float, float] = (0.0, 0.0)
    """Direction it blows towards, m/s north and east."""
    charge: Annotated[float, Meta(ge=0, le=1, extra_json_schema={"unit": "1"})] = 1.0
    """Initial charge of the battery."""
    noise: Annotated[float, Meta(ge=0, le=10, extra_json_schema={"unit": "1"})] = 1.0
    """Scale of the sensor noise."""
    seed: int = 0
    """Seed of the noise."""
    boxes: Annotated[tuple[TwinBox, ...], Meta(max_length=64)] = ()
    """What stands on the ground, in the pictures of its camera."""
    parameters: dict[str, float] = {}
    """Values of the vehicle's parameters that differ from the defaults; unknown names are added."""


class MavlinkConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Links and the vehicles connected to them."""

    links: Annotated[tuple[str, ...], Meta(min_length=1)] = ("udpin:127.0.0.1:14550",)
    dialect: str = "ardupilotmega"
    """A dialect of pymavlink, or the path of an XML file."""
    system: SystemId | None = None
    """System id of the vehicle; None takes the first that sends a heartbeat."""
    discover: bool = False
    """Each vehicle that sends a heartbeat becomes a separate robot, below its name."""
    names: dict[str, str] = {}
    """Names of discovered vehicles by system id; `vehicle<id>` without one."""
    key: str | None = None
    """Passphrase or 64 hexadecimal digits: sign messages, accept only signed ones."""
    source_system: SystemId = 255
    """System id of the gateway; ArduPilot accepts the ground station set in MAV_GCS_SYSID."""
    source_component: SystemId = 190
    params: tuple[str, ...] = ("*",)
    """Patterns of parameters to expose."""
    parameters: str | None = None
    """The autopilot's parameter metadata: a file `apm.pdef.xml` or `parameters.json`,
    `ftp:` and its path on board, or `vehicle`: what the vehicle offers of itself."""
    commands: tuple[str, ...] = ("*",)
    """Commands that `service/command` may send: patterns allow those of payloads, full names any."""
    messages: tuple[str, ...] = ()
    """Patterns of additional messages of the dialect to expose: `VIBRATION`, `GPS*`."""
    terrain: str | None = None
    """A folder with tiles of SRTM (`N47E008.hgt`): vehicles are sent the heights that they ask for."""
    forward: bool = False
    """Expose whole frames, for ground stations behind the gateway (`[plugins.ground_stations]`)."""
    sticks: bool = False
    """Expose the sticks of a transmitter: `actuator/sticks` and `actuator/rc`."""
    rate: Annotated[float, Meta(ge=1, le=50, extra_json_schema={"unit": "Hz"})] = 4.0
    """Rate of the messages that the gateway itself needs: position, landed state, health."""
    timeout: Seconds = 0.6
    """Time-out for a response, before a retry."""
    retries: Annotated[int, Meta(ge=0, le=10)] = 2
    silence: Seconds = 3.5
    """Time without a message after which a vehicle counts as lost."""
    connect: Seconds = 4.0
    """Time-out for the first heartbeat, when the gateway starts."""
    estop: Literal["hold", "land", "disarm"] = "hold"
    """First step of an e-stop in the air; with `disarm`, the vehicle falls."""
    estop_fallback: tuple[Literal["hold", "level", "land"], ...] = ("hold", "level", "land")
    """Further steps, in this order, if the autopilot refuses or the vehicle does not come to rest."""
    estop_timeout: Seconds = 10.0
    """Time for a step of the stop to bring it to rest, before the next step."""
    estop_terminate: bool = False
    """Terminate the flight (the motors stop) if nothing else has brought it to rest."""
    on_loss: Literal["hold", "continue", "land", "return"] = "hold"
    """What to do when the link is restored with a vehicle whose command ended with the link."""
    watchdog: Literal["check", "set", "off"] = "check"
    """The vehicle's failsafes for a silent gateway: read and warn, or enable those that are off."""
    feedback_timeout: Seconds | None = None
    """Maximum age of a position for motion; None: four periods of `rate`, at least 1 s."""
    twin: TwinConfig = TwinConfig()
    """Settings of the vehicles behind `sim:` links."""
    max_speed: Annotated[float, Meta(gt=0, le=100, extra_json_schema={"unit": "m/s"})] = 15.0
    """Limit of `actuator/velocity`."""

    @property
    def feedback_limit(self) -> float:
        """Maximum age of a position for motion, s."""
        # Four periods: one or two messages get lost on any radio, and at 4 Hz they last a second.
        return self.feedback_timeout or max(1.0, 4 / self.rate)

    def __post_init__(self) -> None:
        for link in self.links:
            LinkSpec.of(link)
        for system, name in self.names.items():
            if not (system.isdigit() and 1 <= int(system) <= 255):
                raise ValueError(f"`names`: {system!r} is not a system id (1 to 255)")
            if not _SEGMENT.match(name):
                raise ValueError(f"`names`: {name!r} cannot be a path segment")
        if self.feedback_limit * self.rate < 2:
            raise ValueError("`feedback_timeout` is shorter than two periods of `rate`")
        if self.discover and self.system is not None:
            raise ValueError("`discover` and `system` exclude each other")
