"""Any command of the dialect by its name, with named parameters."""

from __future__ import annotations

import math
import re
from collections.abc import Container, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Annotated, Any, NamedTuple

from msgspec import Meta, Struct

from rcp_kernel.errors import InvalidValue
from rcp_kernel.model import READS, Resource
from rcp_kernel.spi import Progress
from rcp_mavlink.commands import Command, Commands
from rcp_protocol.similarity import closest, nearest

__all__ = ["DirectCommands", "allowed"]

_PREFIX = "MAV_CMD_"
_FRAMES = {"relative": 6, "absolute": 5, "terrain": 11}
_X, _Z = 5, 7  # the parameters that are a position, with the one between
_BOUNDS = {_X: ("latitude", 90), _X + 1: ("longitude", 180)}  # degrees
_HOME = "DO_SET_HOME"  # where it is now, if its first parameter is 1
_LARGEST = 3.4e38  # of a REAL32
_WORD = re.compile(r"[^a-z0-9]+")
_OWN = {
    "COMPONENT_ARM_DISARM": "action/arm or action/disarm",
    "DO_SET_MODE": "action/set_mode",
    "DO_REPOSITION": "action/move_to",
    "DO_CHANGE_SPEED": "param/speed_limit",
    "DO_PAUSE_CONTINUE": "action/mission/pause or resume",
    "MISSION_START": "action/mission/run",
    "PREFLIGHT_CALIBRATION": "action/calibrate",
    "PREFLIGHT_REBOOT_SHUTDOWN": "service/reboot",
    "PREFLIGHT_STORAGE": "service/param/save or action/param/reset",
    "SET_MESSAGE_INTERVAL": "a subscription with a rate",
}
"""Commands that have a path of their own, whose checks and limits they would get around."""
_HARMLESS = (
    "CAMERA_STOP_TRACKING", "CAMERA_TRACK_*", "DO_ACCEPT_MAG_CAL", "DO_CANCEL_MAG_CAL", "DO_CONTROL_VIDEO",
    "DO_DIGICAM_*", "DO_GIMBAL_MANAGER_*", "DO_GRIPPER", "DO_MOUNT_*", "DO_REPEAT_RELAY", "DO_REPEAT_SERVO",
    "DO_SET_CAM_TRIGG_*", "DO_SET_RELAY", "DO_SET_ROI*", "DO_SET_SERVO", "DO_SPRAYER", "DO_TRIGGER_CONTROL", "DO_WINCH",
    "IMAGE_START_CAPTURE", "IMAGE_STOP_CAPTURE", "LOGGING_START", "LOGGING_STOP", "REQUEST_AUTOPILOT_CAPABILITIES",
    "REQUEST_CAMERA_*", "REQUEST_FLIGHT_INFORMATION", "REQUEST_MESSAGE", "REQUEST_PROTOCOL_VERSION",
    "REQUEST_STORAGE_INFORMATION", "REQUEST_VIDEO_*", "SET_CAMERA_*", "VIDEO_START_*", "VIDEO_STOP_*",
)  # fmt: skip
"""Commands of payloads and questions. A pattern allows these alone: each of the others may arm, fly
or reconfigure the vehicle past the gateway, and dialects gain more of them."""


Number = Annotated[float, Meta(extra_json_schema={"unit": "1"})]


class GivenCommand(Struct, frozen=True, forbid_unknown_fields=True):
    """A command, and its parameters."""

    command: Annotated[str, Meta(pattern=r"^[A-Z0-9_]{1,64}$", examples=["DO_SET_SERVO"])]
    """Its name in the dialect, without `MAV_CMD_`."""
    params: dict[str, Number | None] = {}
    """By the names that `service/commands` lists, or as `param1` to `param7`; missing ones are 0,
    null is NaN, which some commands read as unchanged. Positions are in degrees."""
    frame: Annotated[str, Meta(pattern="^(relative|absolute|terrain)$")] = "relative"
    """Reference of the altitude of a position: home, sea or terrain."""
    component: Annotated[int, Meta(ge=1, le=255, extra_json_schema={"unit": "1"})] | None = None
    """Component that is to execute it; null is the autopilot."""


class Acknowledged(Struct, frozen=True):
    """A command that the vehicle has accepted; what it does then is seen in its sensors."""

    command: str
    params: list[Number | None]
    """The seven parameters as sent."""


class CommandQuery(Struct, frozen=True, forbid_unknown_fields=True):
    """Which commands to list."""

    name: Annotated[str, Meta(pattern=r"^[A-Z0-9_*?]{1,64}$", examples=["DO_SET_*"])] = "*"


class ParamInfo(Struct, frozen=True):
    """One parameter of a command."""

    name: str
    number: Annotated[int, Meta(extra_json_schema={"unit": "1"})]
    description: str


class CommandInfo(Struct, frozen=True):
    """A command that may be sent."""

    command: str
    description: str
    params: list[ParamInfo]


class _Known(NamedTuple):
    number: int
    description: str
    labels: Mapping[str, int]
    """Number of each parameter, by its name."""
    texts: Mapping[int, str]
    place: bool
    """Whether it has a position."""


def allowed(name: str, patterns: tuple[str, ...]) -> bool:
    """Tell whether a command may be sent; what is not harmless has to be named in full."""
    if name in _OWN or name.startswith("NAV_"):
        return False
    if name in patterns:
        return True
    harmless = any(fnmatchcase(name, pattern) for pattern in _HARMLESS)
    return harmless and any(fnmatchcase(name, pattern) for pattern in patterns)


class DirectCommands:
    """The commands of a dialect that `patterns` allow, for one vehicle."""

    def __init__(self, module: Any, commands: Commands, patterns: tuple[str, ...]) -> None:
        self._commands, self._patterns = commands, patterns
        self._known: dict[str, _Known] = {
            entry.name.removeprefix(_PREFIX): _known(number, entry)
            for number, entry in module.enums["MAV_CMD"].items()
            if not entry.name.endswith("_ENUM_END")
        }

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            Resource(name="service/command", moves=True, description="Send a command of the dialect; completes when the vehicle accepts it.", input=GivenCommand, output=Acknowledged, examples=({"command": "DO_SET_SERVO", "params": {"instance": 9, "pwm": 1500}},), timeout=60, max_age=30.0),
            Resource(name="service/commands", meta=READS, description="List the commands that may be sent, with their parameters.", input=CommandQuery | None, output=list[CommandInfo], examples=({"name": "DO_SET_*"},)),
        ]  # fmt: skip

    async def list(self, given: CommandQuery | None, _: Progress) -> list[CommandInfo]:
        """List those that may be sent."""
        pattern = (given or CommandQuery()).name.removeprefix(_PREFIX)
        return [
            CommandInfo(
                name,
                known.description,
                [ParamInfo(label, n, known.texts.get(n, "")) for label, n in known.labels.items()],
            )
            for name, known in sorted(self._known.items())
            if fnmatchcase(name, pattern) and allowed(name, self._patterns)
        ]

    async def send(self, given: GivenCommand, progress: Progress) -> Acknowledged:
        """Send a command until the vehicle accepts it.

        :raises InvalidValue: there is no such command, it may not be sent, or has no such parameter.
        :raises DeviceRejected: the vehicle refuses it.
        """
        name = given.command.removeprefix(_PREFIX)
        known = self._find(name)
        p = _params(name, known, given.params)
        if known.place:
            needed = () if name == _HOME and p[0] == 1 else _BOUNDS
            _check_place(name, p, needed, {_number(label, known) for label in given.params})
        await self._commands.send(
            Command(
                known.number,
                (p[0], p[1], p[2], p[3]),
                p[4],
                p[5],
                p[6],
                _FRAMES[given.frame],
                place=known.place,
                whole=known.place,
                component=given.component,
            ),
            name,
            lambda done: progress(fraction=done),
        )
        return Acknowledged(name, [None if math.isnan(each) else each for each in p])

    def _find(self, name: str) -> _Known:
        known = self._known.get(name)
        if known is None:
            near = nearest(name, self._known)
            raise InvalidValue(
                f"there is no command {name}",
                remedy=f"Did you mean {' or '.join(near)}?" if near else "See service/commands.",
                details={"pointer": "/command"},
            )
        if not allowed(name, self._patterns):
            raise InvalidValue(
                f"{name} is not sent this way",
                remedy=_instead(name),
                details={"pointer": "/command"},
            )
        return known


def _instead(name: str) -> str:
    own = _OWN.get(name)
    if own is not None:
        return f"Use {own}."
    if name.startswith("NAV_"):
        return "Use action/takeoff, land, rtl or move_to, or upload a mission with this item."
    return f'Whoever runs the gateway allows it with `commands = ["{name}"]` of the backend.'


def _known(number: int, entry: Any) -> _Known:
    texts: dict[int, str] = entry.param
    meant = {n: text for n, text in texts.items() if not text.startswith(("Empty", "Reserved"))}
    labels = {_snake(label): place for place, label in getattr(entry, "label", {}).items()}
    return _Known(
        number,
        entry.description,
        {**labels, **{f"param{n}": n for n in meant if n not in labels.values()}},
        meant,
        bool(getattr(entry, "has_location", False)),
    )


def _snake(label: str) -> str:
    return _WORD.sub("_", label.lower()).strip("_")


def _check_place(
    name: str, params: Sequence[float], needed: Container[int], given: Container[int | None]
) -> None:
    """Refuse a position that is not on the earth; what is needed is not 0 unless it was given.

    :raises InvalidValue: latitude or longitude is missing, null or out of bounds.
    """
    for number, (word, limit) in _BOUNDS.items():
        value = params[number - 1]
        missing = number in needed and number not in given
        if missing or not abs(value) <= limit:
            raise InvalidValue(
                f"{name}: {word} is {'missing' if missing else _written(value)}",
                remedy=f"Give it in degrees, -{limit} to {limit}.",
                details={"pointer": "/params"},
            )


def _written(value: float) -> str:
    return "null" if math.isnan(value) else f"{value:g}"


def _number(label: str, known: _Known) -> int | None:
    """Return the number of a parameter by one of its names."""
    number = known.labels.get(label)
    if number is None and (match := re.fullmatch(r"param([1-7])", label)):
        number = int(match[1])
    return number


def _params(name: str, known: _Known, given: Mapping[str, float | None]) -> list[float]:
    """Return the seven parameters.

    :raises InvalidValue: a name is none of the command's, or stands twice; a value is too large.
    """
    found = [0.0] * _Z
    taken: dict[int, str] = {}
    for label, value in given.items():
        number = _number(label, known)
        if number is None:
            near = closest(label, known.labels)
            named = [each for each in known.labels if not each.startswith("param")]
            raise InvalidValue(
                f"{name} has no parameter {label}",
                remedy=f"Did you mean {near}?"
                if near
                else f"It has {', '.join(named) or 'none with a name'}.",
                details={"pointer": f"/params/{label}"},
            )
        if number in taken:
            raise InvalidValue(
                f"{name}: {taken[number]} and {label} are the same parameter",
                details={"pointer": f"/params/{label}"},
            )
        if value is not None and abs(value) > _LARGEST:
            raise InvalidValue(
                f"{name}: {label} is too large for a MAVLink message",
                details={"pointer": f"/params/{label}"},
            )
        taken[number] = label
        found[number - 1] = math.nan if value is None else float(value)
    return found
