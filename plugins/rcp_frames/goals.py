"""Goals in any frame, converted to one that the robot takes before anything checks them."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from rcp_frames.config import EARTH, FramesConfig
from rcp_frames.robot import Moment, RobotFrames, no_transform
from rcp_geometry import Rigid, geodetic, local
from rcp_kernel.errors import RcpError
from rcp_kernel.tree.entry import Entry
from rcp_kernel.values import ANY, value_type
from rcp_kernel.wire import Request

__all__ = ["goal_frame", "in_robot_frame", "own_frame"]

_NEEDED = {"position", "frame", "yaw"}


class _Named(msgspec.Struct, frozen=True):
    frame: str | None = None
    position: Any = None


class _Place(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A place on the earth."""

    latitude: Annotated[float, Meta(ge=-90, le=90, extra_json_schema={"unit": "deg"})]
    longitude: Annotated[float, Meta(ge=-180, le=180, extra_json_schema={"unit": "deg"})]
    altitude: Annotated[float, Meta(extra_json_schema={"unit": "m"})] | None = None


class _OnEarth(msgspec.Struct, frozen=True):
    position: _Place
    yaw: float | None = None


class _Turned(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


class _At(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    x: float
    y: float
    z: float | None = None


class _Local(msgspec.Struct, frozen=True):
    position: _At
    yaw: float | None = None
    orientation: _Turned | None = None


_NAMED, _ON_EARTH, _LOCAL = value_type(_Named), value_type(_OnEarth), value_type(_Local)


@cache
def goal_frame(type_: Any) -> str | None:
    """Return the frame of a goal that names none; None: the type is not that of a goal."""
    if not (isinstance(type_, type) and issubclass(type_, msgspec.Struct)):
        return None
    known = {field.name: field for field in msgspec.structs.fields(type_)}
    if not known.keys() >= _NEEDED:
        return None
    default = known["frame"].default
    return default if isinstance(default, str) else None


def own_frame(entry: Entry, default: str, robot: RobotFrames) -> str:
    """Return the frame into which goals are converted: that of the robot's own pose.

    Fences compare goals with it.
    """
    taken = entry.unit.facts.frames or entry.unit.whole.facts.frames
    return taken[0] if taken else robot.base or default


def in_robot_frame(
    request: Request,
    entry: Entry,
    default: str,
    robot: RobotFrames,
    moment: Moment,
    config: FramesConfig,
) -> Any:
    """Return the goal of a request in the robot's own frame, as plain data; None: it is so already.

    :raises RcpError: it cannot be converted, and the robot does not take it as it is.
    """
    label = f"input of {entry.label}"
    try:
        named = request.decode_body(_NAMED, label)
    except RcpError:  # the type of the resource says better what is wrong
        return None
    own, frame = own_frame(entry, default, robot), named.frame or default
    if frame == own or named.position is None:
        return None
    known = robot.known(own)
    if frame not in known:
        facts = entry.unit.facts.frames or entry.unit.whole.facts.frames
        if frame in facts or not (facts or frame == EARTH or frame in config.origins):
            return None
        raise no_transform(own, frame, known)
    plain = request.decode_body(ANY, label)
    moved = _from_earth if frame == EARTH else _from_local
    return {**plain, **moved(request, own, frame, robot, moment)}


def _from_earth(
    request: Request, own: str, _: str, robot: RobotFrames, moment: Moment
) -> dict[str, Any]:
    goal = request.decode_body(_ON_EARTH, "goal")
    place = goal.position
    earth = robot.transform(own, EARTH, moment)
    altitude = place.altitude
    if altitude is None:  # that of the robot's frame; it keeps its height
        altitude = geodetic(earth.inverse.position)[2]
    there = earth.join(local(place.latitude, place.longitude, altitude))
    found = _position(own, there.position, place.altitude)
    return found if goal.yaw is None else {**found, "yaw": there.yaw(goal.yaw)}


def _from_local(
    request: Request, own: str, frame: str, robot: RobotFrames, moment: Moment
) -> dict[str, Any]:
    goal = request.decode_body(_LOCAL, "goal")
    pose: Rigid = robot.transform(own, frame, moment)
    at = goal.position
    found = _position(own, pose.point((at.x, at.y, at.z or 0.0)), at.z)
    if goal.yaw is not None:
        found["yaw"] = pose.yaw(goal.yaw)
    if (turned := goal.orientation) is not None:
        q = pose.turn((turned.x, turned.y, turned.z, turned.w))
        found["orientation"] = dict(zip("xyzw", q, strict=True))
    return found


def _position(own: str, at: tuple[float, float, float], height: float | None) -> dict[str, Any]:
    """Return where a goal is in the robot's frame; without a height the robot keeps its own."""
    x, y, z = at
    position = {"x": x, "y": y} if height is None else {"x": x, "y": y, "z": z}
    return {"frame": own, "position": position}
