"""`action/move_to` with Nav2's NavigateToPose: the profiles' goal, feedback and result."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from collections.abc import Set as AbstractSet
from typing import Any

import msgspec

from rcp_kernel.errors import InvalidValue, RcpError
from rcp_kernel.spi import Progress
from rcp_kernel.types import PoseStamped
from rcp_profiles import messages as m
from rcp_ros2.actions import Run
from rcp_ros2.binding import Shared
from rcp_ros2.cdr import Codec
from rcp_ros2.config import Mapping
from rcp_ros2.shapes import extended, seconds, stamped_pose
from rcp_ros2.standard import defined
from rcp_ros2.types import inward

__all__ = ["Going", "located"]

_NEAR = 0.05  # m within which a goal has no direction


class Going(Run):
    """A navigator."""

    def __init__(
        self,
        shared: Shared,
        name: str,
        standard: str,
        mapping: Mapping,
        action: Any,
        *,
        locate: Callable[[], Awaitable[PoseStamped | None]],
        frames: Callable[[], AbstractSet[str]],
    ) -> None:
        """Measure poses with `locate`, and take goals in the known `frames`."""
        super().__init__(shared, name, mapping, action)
        self._locate = locate
        self._frames = frames
        self._goal = inward(action.Goal)
        self._output = extended(m.MoveResult, Codec(action.Result).type)
        self._progress_type = extended(m.MoveFeedback, Codec(action.Feedback).type)
        own = self.resource
        self.resource = defined(
            name,
            standard,
            mapping,
            input=_goal_type(self._goal),
            output=self._output,
            feedback=self._progress_type,
            native=own.native,
            meta=own.meta,
        )
        self.standard = standard

    async def execute(self, value: Any, progress: Progress) -> Any:
        """Go to a place; raises as for any action.

        :raises InvalidValue: the navigator cannot have such a goal.
        """
        goal = self._fill(self._native(value)) if value.pose is not None else None
        if goal is None:
            goal = await self._sent(value)
        last: Any = None

        def report(feedback: Any = None, *, fraction: float | None = None) -> None:
            nonlocal last
            if feedback is None:
                progress(fraction=fraction)
                return
            last = feedback
            progress(_told(self._progress_type, feedback))

        result = await self.follow(goal, report)
        pose, error = await self._arrived(goal.pose, last)
        return self._output(pose=pose, error=error, **_more(self._output, result))

    def _native(self, value: Any) -> Any:
        if value.position is not None:
            raise InvalidValue("give 'position' or 'pose', not both")
        names = msgspec.structs.fields(self._goal)
        return self._goal(**{field.name: getattr(value, field.name) for field in names})

    async def _sent(self, value: Any) -> Any:
        if value.position is None:
            raise InvalidValue("a goal needs a 'position'", details={"pointer": "/position"})
        for field in ("speed", "tolerance"):
            if getattr(value, field) is not None:
                raise InvalidValue(
                    f"'{field}' cannot be set for one goal",
                    details={"pointer": f"/{field}"},
                    remedy="Leave it out; `param/speed_limit` applies to every goal.",
                )
        here = await self._locate()
        known = self._frames() | ({here.frame_id} if here is not None else set())
        if value.frame not in known:
            raise InvalidValue(
                f"the robot has no frame '{value.frame}'",
                details={"pointer": "/frame"},
                remedy=f"Give the goal in one of {', '.join(sorted(known))}.",
            )
        goal = self.action.Goal()
        if hasattr(goal, "behavior_tree"):
            goal.behavior_tree = value.behavior_tree
        goal.pose.header.frame_id = value.frame
        at, pose = value.position, goal.pose.pose
        pose.position.x, pose.position.y, pose.position.z = float(at.x), float(at.y), 0.0
        yaw = _heading(here, value) if value.yaw is None else value.yaw
        pose.orientation.z, pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        return goal

    async def _arrived(self, goal: Any, last: Any) -> tuple[PoseStamped | None, float | None]:
        """Return the measured pose after a goal, and its distance from the goal; None if unknown."""
        frame, at = goal.header.frame_id, goal.pose.position
        found = await self._locate()
        if (found is None or found.frame_id != frame) and hasattr(last, "current_pose"):
            found = stamped_pose(last.current_pose)
        if found is None:
            return None, None
        if found.frame_id != frame:
            left = getattr(last, "distance_remaining", None)
            return found, None if left is None else max(0.0, float(left))
        return found, math.hypot(found.position.x - at.x, found.position.y - at.y)


def _heading(pose: PoseStamped | None, goal: Any) -> float:
    """Return the heading of the way to a goal: Nav2 turns to the one of its goal in any case."""
    if pose is None or pose.frame_id != goal.frame:
        return 0.0
    x, y = goal.position.x - pose.position.x, goal.position.y - pose.position.y
    q = pose.orientation
    now = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
    return now if math.hypot(x, y) < _NEAR else math.atan2(y, x)


def _goal_type(native: type[msgspec.Struct]) -> Any:
    """Return the profile's goal, or in its place a `pose` as the action itself has it."""
    fields: list[Any] = [("position", m.GoalPoint | None, None)]
    known = {field.name for field in msgspec.structs.fields(m.MoveTo)}
    for field in msgspec.structs.fields(native):
        if field.name == "pose":
            fields.append(("pose", field.type | None, None))
        elif field.name not in known:
            fields.append((field.name, field.type, field.default))
    return msgspec.defstruct(
        "MoveTo",
        fields,
        bases=(m.MoveTo,),
        namespace={"__doc__": m.MoveTo.__doc__},
        module=native.__module__,
        frozen=True,
        forbid_unknown_fields=True,
        kw_only=True,
    )


def _more(type_: Any, native: Any) -> dict[str, Any]:
    """Return the fields of a type that a message has as well."""
    names = (field.name for field in msgspec.structs.fields(type_))
    return {name: getattr(native, name) for name in names if hasattr(native, name)}


def _told(type_: Any, native: Any) -> Any:
    left = max(0.0, native.distance_remaining)
    eta = seconds(native.estimated_time_remaining)
    more = _more(type_, native)
    # Nav2 tells zero until it has an estimate
    return type_(**(more | {"distance_remaining": left, "eta": eta if eta > 0 else None}))


async def located(read: Callable[[], Awaitable[Any]] | None) -> PoseStamped | None:
    """Return the measured pose; None if there is none now."""
    if read is None:
        return None
    try:
        return await read()
    except (RcpError, ValueError):
        return None
