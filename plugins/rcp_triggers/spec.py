"""What a trigger is: its condition, and what it does. The same in the configuration and on the wire."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from rcp_conditions import Condition, condition
from rcp_kernel.contract.paths import ESTOP
from rcp_kernel.errors import ConfigError, RcpError
from rcp_kernel.model import parse_path
from rcp_protocol.plain import is_list, is_map
from rcp_triggers.machine import Timing
from rcp_triggers.place import Place, RobotPattern

__all__ = ["NAME", "Conditions", "Do", "Severity", "Spec", "command_for"]

NAME = "^[A-Za-z0-9][A-Za-z0-9_.-]*$"
_Condition = Annotated[str, Meta(min_length=1, max_length=2000)]
_Held = Annotated[float, Meta(ge=0, le=86_400, extra_json_schema={"unit": "s"})]
_Often = Annotated[float, Meta(ge=1, le=604_800, extra_json_schema={"unit": "s"})]
_Robot = Annotated[str, Meta(max_length=200)]
Severity = Literal["info", "warning", "critical"]
_ROBOT = "{robot}"
_SYSTEM = (ESTOP, "/system/plans", "/system/recorder")
"""The gateway's own services that a trigger may use."""


class Do(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A command: an action or a service, or `/system/plans` with a plan."""

    path: Annotated[str, Meta(min_length=1, max_length=512)]
    """Without a tenant it is that of the robot; `{robot}` is the robot's name."""
    value: Any = None


class Spec(
    msgspec.Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    omit_defaults=True,
    rename={"held": "for"},
):
    """A condition on a robot, and what happens when it holds."""

    robot: _Robot
    """`/tenant/alpha`, `/tenant/alpha/rover`, or `/tenant/alpha/*` for each robot of a tenant."""
    when: _Condition
    """CEL over the robot's values, as in access rules."""
    clear: _Condition | None = None
    """Clears it, instead of `when` being false: hysteresis."""
    held: _Held = 0.0
    """How long `when` must hold."""
    on: Literal["level", "edge"] = "level"
    """`level`: fires if it holds; `edge`: only if it was seen false before."""
    repeat: _Often | None = None
    """Fires again in this interval while it stays active."""
    cool_down: _Held = 0.0
    """Least time between two firings for one robot."""
    message: Annotated[str, Meta(max_length=500)] = ""
    """For people; by default the condition."""
    severity: Severity = "warning"
    notify: Annotated[tuple[str, ...], Meta(max_length=16)] = ()
    """Names of the targets in the gateway's configuration."""
    notify_cleared: bool = False
    """Whether they also learn when it clears."""
    alarm: bool = False
    """Whether it raises an alarm that somebody must acknowledge."""
    incident: bool = False
    """Whether the black box of the recorder is written."""
    execute: Do | None = None

    @property
    def timing(self) -> Timing:
        """The times by which it fires."""
        return Timing(
            self.held, self.on == "edge", self.repeat, self.cool_down, self.clear is not None
        )

    @property
    def text(self) -> str:
        """What it says to people."""
        return self.message or self.when


class Conditions:
    """The compiled parts of a specification.

    :raises ConfigError: something in it is wrong.
    """

    def __init__(self, spec: Spec) -> None:
        try:
            self.robots = RobotPattern(spec.robot)
        except ValueError as error:
            raise ConfigError(f"robot: {error}") from None
        self.when: Condition = condition(spec.when)
        self.clear: Condition | None = None if spec.clear is None else condition(spec.clear)
        if spec.on == "edge" and spec.repeat is not None:
            raise ConfigError('`repeat` goes with on = "level"')
        if not (spec.notify or spec.alarm or spec.incident or spec.execute):
            raise ConfigError("it does nothing: give `notify`, `alarm`, `incident` or `execute`")
        if spec.execute is not None:
            _check_command(spec.execute)

    @property
    def all(self) -> tuple[Condition, ...]:
        """Both conditions."""
        return (self.when,) if self.clear is None else (self.when, self.clear)


def _check_command(do: Do) -> None:
    if do.path.startswith("/system/"):
        if do.path not in _SYSTEM:
            raise ConfigError(
                f"execute: a trigger cannot use {do.path}; of the gateway's own services it can "
                f"use {', '.join(_SYSTEM)}"
            )
        if do.path == ESTOP and is_map(do.value) and do.value.get("reset"):
            raise ConfigError("execute: a trigger can request an e-stop, but never reset one")
    else:
        try:
            parse_path(do.path.replace(_ROBOT, "robot"), "tenant")
        except RcpError as error:
            raise ConfigError(f"execute: {error.message}") from None


def command_for(do: Do, place: Place) -> tuple[str, Any]:
    """Return the path and the value of a command for a robot."""
    name = place.robot or ""
    path = do.path.replace(_ROBOT, name).replace("//", "/")
    return parse_path(path, place.tenant), _filled(do.value, name)


def _filled(value: Any, robot: str) -> Any:
    if isinstance(value, str):
        return value.replace(_ROBOT, robot)
    if is_map(value):
        return {key: _filled(item, robot) for key, item in value.items()}
    if is_list(value):
        return [_filled(item, robot) for item in value]
    return value
