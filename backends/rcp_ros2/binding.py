"""Bindings of paths to ROS: the common part of topics, services, actions and parameters."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from rcp_kernel.errors import AdapterUnavailable, DeviceTimeout, UnsupportedOperation
from rcp_kernel.model import MOVING, Resource, kind_of
from rcp_kernel.spi import Host, Progress, check_fence
from rcp_ros2.cdr import Codec
from rcp_ros2.config import Mapping, Qos, Ros2Config
from rcp_ros2.graph import Graph
from rcp_ros2.idl import MissingType, load
from rcp_ros2.naming import Naming
from rcp_ros2.outbox import Outbox
from rcp_ros2.pulse import Pulses
from rcp_ros2.ros import Ros
from rcp_ros2.topics import Tap, TopicSubscriptions

if TYPE_CHECKING:
    from rcp_ros2.feedback import Feedback, Feedbacks
    from rcp_ros2.keeper import Keeper

__all__ = ["Absent", "Binding", "Construct", "Offer", "Shared", "common"]

_DEPTH = 200  # messages of a construct that may wait: they come in bursts
_GOALS = 1000  # of the gateway's own whose ids are remembered
_PAUSE = 0.05  # s between looks at something that is about to come


class Shared:
    """State shared by all bindings of a backend."""

    keeper: Keeper
    feedbacks: Feedbacks

    def __init__(self, ros: Ros, config: Ros2Config, host: Host) -> None:
        self.ros = ros
        self.config = config
        self.host = host
        self.graph = Graph()
        """The latest poll of the graph."""
        self.naming = Naming(config)
        self.outbox = Outbox(host)
        self._troubles: dict[str, str] = {}
        self._reported = False
        self._complaints: dict[str, str | None] = {}
        self.subscriptions = TopicSubscriptions(ros, self.outbox, self.complain)
        self.pulses = Pulses(ros, self.complain)
        self.on_poll: list[Callable[[], None]] = []
        """Called in the ROS thread at each poll of the graph."""
        self.refresh: Callable[[], None] = lambda: None
        """Has the paths made that a construct has found since the last look; on the event loop."""
        self.needed: set[str] = set()
        """Names that are relevant although no path maps to them."""
        self.sent_goals: dict[bytes, None] = {}
        """Ids of goals sent by the gateway, newest last."""
        self._settled = time.monotonic() + config.grace

    @property
    def settling(self) -> float:
        """Remaining time in s for the discovery of the graph."""
        return max(0.0, self._settled - time.monotonic())

    def trouble(self, key: str, detail: str | None) -> None:
        """Set or clear the complaint about one thing."""
        if detail is not None:
            self._troubles[key] = detail
        else:
            self._troubles.pop(key, None)

    def report(self) -> None:
        """Report all complaints, or once that there are none."""
        detail = "; ".join(self._troubles.values()) or None
        if detail is not None or self._reported:
            self._reported = detail is not None
            self.host.report(detail)

    def sent(self, goal: bytes) -> None:
        """Remember the id of a goal sent by the gateway."""
        self.sent_goals[goal] = None
        if len(self.sent_goals) > _GOALS:
            del self.sent_goals[next(iter(self.sent_goals))]

    def complain(self, key: str, detail: str | None) -> None:
        """Set a complaint from the ROS thread; only changes wake the event loop."""
        if self._complaints.get(key) != detail:
            self._complaints[key] = detail
            self.host.call_soon(self.trouble, key, detail)

    def listen(
        self,
        topic: str,
        type_: str,
        key: str,
        taker: Callable[[Any], None],
        qos: Qos = Qos(depth=_DEPTH),  # noqa: B008 - frozen
    ) -> None:
        """Call a function with each message of a topic; in the ROS thread.

        A type that is not installed is a trouble, told with its remedy.
        """
        try:
            cls = load(type_)
        except MissingType as error:
            self.complain(key, f"{topic} cannot be subscribed to: {error}. {error.remedy}")
            return
        tap = Tap(key, Codec(cls), taker=lambda value: taker(value.decode()))
        self.subscriptions.tap(topic, cls, qos, tap)

    async def until(self, holds: Callable[[], bool], seconds: float) -> bool:
        """Wait for a condition on the graph, for as long as discovery may take."""
        end = time.monotonic() + seconds
        while not holds():
            if time.monotonic() >= end:
                return False
            await asyncio.sleep(_PAUSE)
        return True

    async def present(self, noun: str, name: str) -> None:
        """Wait until a node offers something.

        :raises AdapterUnavailable: nobody does.
        """
        if await self.until(lambda: self.graph.has(noun, name), self.settling):
            return
        raise AdapterUnavailable(
            f"the {noun} {name} is not running"
            if noun.endswith("node")
            else f"no node offers {noun} {name}",
            remedy="Start the node that provides it; the gateway discovers it automatically.",
        )


class Binding:
    """One resource and its implementation; refuses what a subclass does not override."""

    def __init__(self, shared: Shared, resource: Resource, mapping: Mapping) -> None:
        self.shared = shared
        self.resource = resource
        self.mapping = mapping
        self.feedback: Feedback | None = None
        """Feedback of the motion that it causes, if mapped."""

    @property
    def is_barred(self) -> bool:
        """Whether it moves or energises the robot, and is refused under an e-stop."""
        resource = self.resource
        moves = kind_of(resource.name) in MOVING if resource.moves is None else resource.moves
        return moves or resource.energises

    def admit(self) -> None:
        """Check a command that moves or energises; in the ROS thread, just before it is sent.

        :raises EstopActive: the robot was stopped since.
        """
        if not self.is_barred:
            return
        check_fence()
        self.shared.keeper.admit(self.resource.robot)

    @property
    def timeout(self) -> float:
        """Time-out in s for one response of the robot."""
        return self.mapping.timeout or self.shared.config.timeout

    async def read(self) -> Any:
        """Return the current value."""
        raise UnsupportedOperation(f"'{self.resource.name}' cannot be read")

    async def write(self, value: Any) -> Any:
        """Write a value."""
        raise UnsupportedOperation(f"'{self.resource.name}' cannot be written")

    async def execute(self, value: Any, progress: Progress) -> Any:
        """Run it to its end."""
        raise UnsupportedOperation(f"'{self.resource.name}' cannot be executed")

    def watched(self, rate: float) -> None:
        """Publish at most `rate` values per second; infinity: all of them."""

    def unwatched(self) -> None:
        """Stop publishing."""

    def placed(self) -> None:
        """Publish what is already known, after the resource was declared."""

    async def halt(self) -> None:
        """Stop what it moves."""

    def close(self) -> None:
        """Release its ROS entities."""

    def late(self, what: str) -> DeviceTimeout:
        """Make the error for a missing response."""
        return DeviceTimeout(f"{what} did not respond within {self.timeout:g} s")


class Absent(Binding):
    """A mapping that is not available: its type is missing or not known yet."""

    def __init__(
        self, shared: Shared, resource: Resource, mapping: Mapping, why: str, remedy: str
    ) -> None:
        super().__init__(shared, resource, mapping)
        self.why = why
        self._remedy = remedy

    def _error(self) -> AdapterUnavailable:
        return AdapterUnavailable(self.why, remedy=self._remedy)

    async def read(self) -> Any:
        """Refuse, with the reason."""
        raise self._error()

    async def write(self, value: Any) -> Any:
        """Refuse, with the reason."""
        raise self._error()

    async def execute(self, value: Any, progress: Progress) -> Any:
        """Refuse, with the reason."""
        raise self._error()


class Offer(NamedTuple):
    """A path provided by a ROS convention."""

    mapping: Mapping
    """Its mapping."""
    make: Callable[[], Binding]
    """Called in the ROS thread; raises `MissingType`."""


class Construct(Protocol):
    """A convention of ROS that is more than one topic or service: nodes with a lifecycle."""

    def find(self, graph: Graph) -> dict[str, Offer]:
        """Return the current paths; on the event loop, at each poll of the graph."""
        ...


def common(name: str, mapping: Mapping, description: str, **facts: Any) -> dict[str, Any]:
    """Return the arguments of a `Resource` that every kind takes from its mapping."""
    text = (mapping.description or description).rstrip()
    out: dict[str, Any] = {
        "name": name,
        "description": text if text.endswith(".") else text + ".",
        "meta": {key: value for key, value in facts.items() if value is not None},
    }
    for key in ("deadline", "timeout", "policy", "max_age", "history", "moves", "energises"):
        if (value := getattr(mapping, key)) is not None:
            out[key] = value
    return out
