"""Frames on request: the values of resources in the frames that clients name."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any
from weakref import WeakValueDictionary

from rcp_frames.config import EARTH, FramesConfig
from rcp_frames.demand import PoseDemand
from rcp_frames.feeds import ConvertedFeed
from rcp_frames.goal_schema import widened
from rcp_frames.goals import goal_frame, in_robot_frame, own_frame
from rcp_frames.moves import Move
from rcp_frames.named import PLACES, named_goal
from rcp_frames.remote import RemoteStreams, RemoteView, names_frame
from rcp_frames.robot import (
    FrameAccess,
    Moment,
    RobotFrames,
    no_transform,
    pose_path,
    remote_poses,
    tree_poses,
)
from rcp_frames.shapes import Shape, shape_of
from rcp_kernel.access.acl import Rights, reach
from rcp_kernel.errors import FilterUnsupported, RcpError
from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Operation
from rcp_kernel.sessions.outbox import Outbox
from rcp_kernel.sessions.session import Session
from rcp_kernel.spi import Anchor
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample
from rcp_kernel.values import ANY
from rcp_kernel.wire import Request
from rcp_streams.frames import FrameView
from rcp_streams.path_subscription import Subscriber

__all__ = ["Frames"]

_AGAIN = 10_000_000  # ns after which a sample without a transform is tried again
_SEES = int(Operation.READ | Operation.SUBSCRIBE)


class Frames:
    """The `FrameConverter` of a gateway."""

    def __init__(self, config: FramesConfig, host: FeatureHost) -> None:
        self.config = config
        self._entries = host.robots.entries
        self._now = host.clock.now
        self._service = host.service
        self._demand = PoseDemand(host.robots, host.loop)
        self._remote = RemoteStreams(host.clock.now)
        self._conversions: WeakValueDictionary[tuple[Entry, str, FrameAccess], _Conversion] = (
            WeakValueDictionary()
        )

    def close(self) -> None:
        """End what it receives."""
        self._demand.close()
        self._remote.close()

    def configure(self, config: FramesConfig) -> None:
        """Apply another configuration, to running subscriptions too."""
        self.config = config
        self._conversions.clear()

    def converts(self, entry: Entry) -> bool:
        """Return whether a resource's values name their frame."""
        if entry.owner.has_gateways:
            return names_frame(entry.value_type)
        return entry.tenant is not None and shape_of(entry.resource.value) is not None

    def view(self, session: Session, entry: Entry, frame: str) -> FrameView:
        """Return a resource's values in a frame.

        :raises FilterUnsupported: its values name no frame.
        """
        if entry.owner.has_gateways and names_frame(entry.value_type):
            locates = partial(self._locates, session)
            return RemoteView(self._remote, session, entry, frame, locates)
        shape = shape_of(entry.resource.value) if entry.tenant is not None else None
        if shape is None:
            raise FilterUnsupported(
                f"the values of {entry.path} have no frame that they could be converted from",
                path=entry.path,
                remedy="Omit `frame`; `discover` lists the `frames` of resources that have them.",
            )
        return _View(self, session, entry, shape, frame)

    def conversion(self, rights: Rights, entry: Entry, shape: Shape, frame: str) -> _Conversion:
        """Return the conversion that all who may know as much share."""
        key = (entry, frame, self._access(rights, entry))
        found = self._conversions.get(key)
        if found is None:
            robot = self._robot(entry, key[2])
            found = self._conversions[key] = _Conversion(robot, entry, shape, frame, self._now)
        return found

    def takes(self, entry: Entry) -> bool:
        """Return whether a resource's input is a goal in a frame."""
        return entry.tenant is not None and goal_frame(entry.resource.input) is not None

    def goal(self, session: Session, request: Request, entry: Entry) -> Any:
        """Return a goal in a frame that the robot takes; None: it is so already.

        :raises RcpError: nothing leads from its frame to one that the robot takes.
        """
        own = goal_frame(entry.resource.input) if entry.tenant is not None else None
        if own is None:
            return None
        robot = self._robot(entry, self._access(session.rights, entry))
        moment = Moment(None, self._now())
        label = f"input of {entry.label}"
        find = self._service(PLACES)
        named = (
            None
            if find is None or entry.tenant is None
            else named_goal(find, session, request, entry.tenant, label)
        )
        if named is None:
            goal = in_robot_frame(request, entry, own, robot, moment, self.config)
            return None if goal is None else entry.input_type.convert(goal, label)
        goal = in_robot_frame(named.request, entry, own, robot, moment, self.config)
        if goal is None:
            goal = named.request.decode_body(ANY, label)
        there = named.beside(goal, own_frame(entry, own, robot), robot, moment)
        return entry.input_type.convert(there, label)

    def known(self, rights: Rights, entry: Entry) -> list[str]:
        """Return the frames of a resource, for a principal."""
        if entry.tenant is None:
            return []
        if entry.owner.has_gateways:
            return self._remote_frames(rights, entry)
        robot = self._robot(entry, self._access(rights, entry))
        default = goal_frame(entry.resource.input)
        if default is not None:
            source = own_frame(entry, default, robot)
        else:
            shape = shape_of(entry.resource.value)
            if shape is None:
                return []
            try:
                source = shape.current(entry)
            except RcpError:  # reported as its backend's fault
                return []
        return robot.known(source)

    def _remote_frames(self, rights: Rights, entry: Entry) -> list[str]:
        """Return what the robot's own gateway listed, to those who may know where the robot is."""
        backend = entry.owner.backend
        found = () if backend is None else backend.frames_of(entry.name)
        seen = found and all(self._may_locate(rights, path) for path in remote_poses(entry))
        return list(found) if seen else []

    def command_schema(
        self, entry: Entry, frames: list[str], schema: dict[str, Any]
    ) -> dict[str, Any] | None:
        """Return the schema of a goal that may be on the earth or at a place; None: neither."""
        if entry.owner.has_gateways:  # whether there are places, its gateway knows
            return widened(schema, earth=EARTH in frames, places=False)
        if goal_frame(entry.resource.input) is None:
            return None
        return widened(schema, earth=EARTH in frames, places=self._service(PLACES) is not None)

    def _robot(self, entry: Entry, access: FrameAccess) -> RobotFrames:
        request = self._demand.request
        return RobotFrames(entry, self._entries, self.config, access=access, request=request)

    def _access(self, rights: Rights, entry: Entry) -> FrameAccess:
        """Return which transforms a principal may know: those of robots whose poses it may read."""
        if not self._may_locate(rights, pose_path(entry)):
            return FrameAccess.FIXED
        others = tree_poses(entry)
        return (
            FrameAccess.ALL
            if all(self._may_locate(rights, path) for path in others)
            else FrameAccess.OWN
        )

    def _locates(self, session: Session, entry: Entry, *, ever: bool = False) -> bool:
        """Return whether a session may know where a robot with its own gateway is; `ever`: at times."""
        may = self._could_locate if ever else self._may_locate
        return all(may(session.rights, path) for path in remote_poses(entry))

    @staticmethod
    def _could_locate(rights: Rights, path: str) -> bool:
        return bool(reach(rights.compute_mask(path)) & _SEES)

    def _may_locate(self, rights: Rights, path: str) -> bool:
        """Return whether a principal may learn where a robot is: whoever may read its pose."""
        pose = self._entries.get(path)
        if pose is None:
            return bool(rights.compute_mask(path) & _SEES)
        return bool(rights.mask(path) & _SEES) or rights.permits(pose, Operation.READ)


class _View:
    """A resource's values in a frame, as far as a session may know the robot's place."""

    remote = False

    def __init__(
        self, frames: Frames, session: Session, entry: Entry, shape: Shape, frame: str
    ) -> None:
        self._frames, self._session, self._entry = frames, session, entry
        self._shape, self._frame = shape, frame
        self.value_type = shape.earth if frame == EARTH else shape.type
        self._shared: _Conversion | None = None
        """Kept, so that others find it."""

    def _conversion(self) -> _Conversion:
        rights = self._session.rights
        self._shared = self._frames.conversion(rights, self._entry, self._shape, self._frame)
        return self._shared

    def check(self) -> None:
        """Make sure that the frame is known.

        :raises InvalidValue: it is not.
        """
        self._conversion().check()

    def convert(self, sample: Sample) -> Sample:
        """Return a sample in the frame; raises as `RobotFrames.transform`."""
        return self._conversion().convert(sample)

    def feed(self, subscription: Subscriber, entry: Entry, outbox: Outbox | None) -> ConvertedFeed:
        """Create the feed of a subscription."""
        return ConvertedFeed(subscription, entry, outbox, self)


class _Conversion:
    """The conversion of one resource's values to a frame; each is converted once."""

    def __init__(
        self,
        robot: RobotFrames,
        entry: Entry,
        shape: Shape,
        frame: str,
        now: Callable[[], int],
    ) -> None:
        self._now = now
        self._robot, self._shape, self._frame = robot, shape, frame
        self._geographic = frame == EARTH
        self._entry = entry
        self.path, self.owner = entry.path, entry.owner
        self.value_type = shape.earth if self._geographic else shape.type
        self._last: tuple[Sample, Sample, Anchor | None] | None = None
        """A sample, what it was converted to, and the anchor that it was converted with."""
        self._refused: tuple[Sample, RcpError, int] | None = None
        """A sample that cannot be converted, why, and until when it is not tried again."""

    def check(self) -> None:
        """Make sure that something connects the values' frame to the target.

        :raises InvalidValue: nothing does.
        """
        source = self._shape.current(self._entry)
        if source and self._frame not in (known := self._robot.known(source)):
            raise no_transform(self._frame, source, known)

    def convert(self, sample: Sample) -> Sample:
        """Return a sample in the frame."""
        last = self._last
        anchor = self._robot.anchor
        if last is not None and last[0] is sample and last[2] is anchor:
            return last[1]
        if self._refused is not None:
            refused, error, until = self._refused
            if refused is sample and self._now() < until:
                raise error
        try:
            converted = self._converted(sample)
        except RcpError as error:
            error = error.with_traceback(None)
            self._refused = sample, error, self._now() + _AGAIN
            raise error from None
        self._last, self._refused = (sample, converted, anchor), None
        return converted

    def _converted(self, sample: Sample) -> Sample:
        value = sample.value
        source = self._shape.frame_of(value)
        if source == self._frame and not self._geographic:
            return sample
        moment = Moment(sample.timestamp, sample.received)
        pose = self._robot.transform(self._frame, source, moment)
        moved = self._shape.moved(value, Move(self._frame, pose, geographic=self._geographic))
        return Sample(self, moved, sample.timestamp, sample.received, sample.seq)
