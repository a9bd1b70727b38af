"""Goals at a named place, and beside it: resolved before their frame is converted."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Raw

from rcp_frames.robot import Moment, RobotFrames
from rcp_kernel.errors import InvalidValue, RcpError
from rcp_kernel.features import ServiceKey
from rcp_kernel.sessions.session import Session
from rcp_kernel.values import ANY, Encoding, value_type
from rcp_kernel.wire import Request

__all__ = ["PLACES", "FindPlace", "NamedGoal", "named_goal"]

FindPlace = Callable[[Session, str, str], dict[str, Any]]
PLACES: ServiceKey[FindPlace] = ServiceKey("places.find")
"""Service of the feature that has the places."""
_BODY = "base_link"


class _At(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    place: Annotated[str, Meta(min_length=1, max_length=64)]
    distance: Annotated[float, Meta(ge=0, le=1000)] | None = None
    z: float | None = None


class _Asked(msgspec.Struct, frozen=True):
    position: dict[str, Any] | None = None


class _Goal(msgspec.Struct, frozen=True):
    position: _At
    yaw: float | None = None
    orientation: Any = None


_ASKED, _GOAL = value_type(_Asked), value_type(_Goal)


class NamedGoal(msgspec.Struct, frozen=True):
    """A goal at a place, in the frame of the place."""

    request: Request
    distance: float | None
    """How far from the place, on the side where the robot is."""
    z: float | None
    """Height in the robot's own frame."""
    turned: bool
    """Whether the goal says where the robot looks."""

    def beside(self, goal: dict[str, Any], own: str, robot: RobotFrames, moment: Moment) -> Any:
        """Return the goal in the robot's own frame, with its height and its distance."""
        at = dict(goal["position"])
        if self.z is not None:
            at["z"] = self.z
        if self.distance is None:
            return {**goal, "position": at}
        x, y, _ = robot.transform(own, _BODY, moment).position
        dx, dy = at["x"] - x, at["y"] - y
        far = math.hypot(dx, dy)
        share = max(0.0, 1 - self.distance / far) if far else 0.0
        moved = {**goal, "position": {**at, "x": x + dx * share, "y": y + dy * share}}
        if not self.turned and far:
            moved["yaw"] = math.atan2(dy, dx)  # it looks at the place
        return moved


def named_goal(
    find: FindPlace, session: Session, request: Request, tenant: str, label: str
) -> NamedGoal | None:
    """Return a goal that names a place; None: it names none.

    :raises InvalidValue: there is no such place, or the goal also has coordinates.
    """
    try:
        asked = request.decode_body(_ASKED, label)
    except RcpError:  # the type of the resource says better what is wrong
        return None
    if asked.position is None or "place" not in asked.position:
        return None
    goal = request.decode_body(_GOAL, label)
    plain = request.decode_body(ANY, label)
    if plain.get("frame") is not None:
        raise InvalidValue(
            "a goal at a place has no `frame`: the place has one",
            details={"pointer": "/frame"},
            remedy="Omit `frame`.",
        )
    found = find(session, tenant, goal.position.place)
    body: dict[str, Any] = {**plain, "frame": found["frame"], "position": found["position"]}
    turned = goal.yaw is not None or goal.orientation is not None
    if not turned and found["yaw"] is not None:
        body["yaw"], turned = found["yaw"], True
    bare = Request(type=request.type, path=request.path, body=Raw(msgspec.json.encode(body)))
    bare.encoding = Encoding.JSON
    return NamedGoal(bare, goal.position.distance, goal.position.z, turned)
