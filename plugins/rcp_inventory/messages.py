"""The items of `/system/robots`. What is unknown, or hidden from the reader, is absent."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from rcp_kernel.spi import Dimensions
from rcp_kernel.types import Time

__all__ = ["Control", "FactSheet", "Reading", "RobotState"]


class Reading(msgspec.Struct, frozen=True, omit_defaults=True):
    """The latest sample of a resource."""

    value: Any
    timestamp: Time
    stale: bool = False
    """Whether the next sample is overdue, or the robot cannot be reached."""


class Control(msgspec.Struct, frozen=True, omit_defaults=True):
    """Who has control of a robot."""

    principal: str
    by: Literal["lease", "command", "write"]
    """A lease, a running command, or a written value that is in force."""
    path: str | None = None
    """The resource that is commanded."""
    scope: str | None = None
    """The scope of the lease."""
    expires: Time | None = None


class FactSheet(msgspec.Struct, frozen=True, omit_defaults=True):
    """What a robot can do."""

    limits: dict[str, dict[str, tuple[float | None, float | None]]] = {}
    """Minimum and maximum by resource (`actuator/cmd_vel`) and field (`linear.x`)."""
    dimensions: Dimensions | None = None
    frames: tuple[str, ...] = ()


class RobotState(msgspec.Struct, frozen=True, omit_defaults=True, kw_only=True):
    """One robot."""

    path: str
    """The scope of the robot, for leases and the e-stop."""
    tenant: str
    state: Literal["starting", "ready", "degraded", "down"]
    estop: bool = False
    """Whether an e-stop is latched."""
    held: bool = False
    """Whether it is being brought to rest without an e-stop."""
    kind: str | None = None
    profiles: tuple[str, ...] = ()
    vendor: str | None = None
    model: str | None = None
    firmware: str | None = None
    serial: str | None = None
    mode: str | None = None
    battery: Reading | None = None
    pose: Reading | None = None
    control: Control | None = None
    fact_sheet: FactSheet | None = None
