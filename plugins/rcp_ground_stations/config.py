"""The configuration: one table per link at which ground stations attach."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rcp_mavlink.config import LinkSpec

__all__ = ["GroundStationsConfig", "StationConfig"]

_KINDS = ("udpin", "udpout", "tcpin", "tcp", "serial")


class StationConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One link, and who a ground station at it is."""

    link: str
    """`udpin:HOST:PORT`, `udpout:HOST:PORT`, `tcpin:HOST:PORT`, `tcp:HOST:PORT` or `serial:DEVICE:BAUD`."""
    robot: Annotated[str, Meta(pattern=r"^/tenant/[^/*]+(/[^/*]+)?$")]
    """Scope of the vehicle: `/tenant/alpha`, or `/tenant/alpha/drone1` where a backend has several."""
    token: str
    """The API key that it acts with: its roles decide whether it may fly, or only look."""
    key: str | None = None
    """Passphrase or 64 hexadecimal digits: accept only frames signed with it, and sign those sent."""
    dialect: str = "ardupilotmega"
    hold: Annotated[float, Meta(ge=1, le=600, extra_json_schema={"unit": "s"})] = 10.0
    """Time without a command after which the ground station gives control back."""

    def __post_init__(self) -> None:
        if LinkSpec.of(self.link).kind not in _KINDS:
            raise ValueError(f"`link`: {self.link!r} leads to no ground station")

    def path(self, branch: str, name: str) -> str:
        """Return the path of one of the vehicle's resources."""
        _, _, tenant, *robot = self.robot.split("/")
        return "/".join(("", "tenant", tenant, branch, *robot, name))


class GroundStationsConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The links by name."""

    stations: dict[str, StationConfig] = {}
