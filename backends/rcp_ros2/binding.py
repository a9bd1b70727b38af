"""What stands behind one path: the common part of topics, services, actions and parameters."""

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
    """What all bindings of a backend work with."""

    keeper: Keeper
    feedbacks: Feedbacks

    def __init__(self, ros: Ros, config: Ros2Config, host: Host) -> None:
        self.ros = ros
        self.config = config
        self.host = host
        self.graph = Graph()
        """The latest look at the graph."""
        self.naming = Naming(config)
        self.outbox = Outbox(host)
        self._troubles: dict[str, str] = {}
        self._reported = False
        self._complaints: dict[str, str | None] = {}
        self.subscriptions = TopicSubscriptions(ros, self.outbox, self.complain)
        self.pulses = Pulses(ros, self.complain)
        self.on_poll: list[Callable[[], None]] = []
        """Called in the ROS thread at each look at the graph."""
        self.refresh: Callable[[], None] = lambda: None
        """Has the paths made that a construct has found since the last look; on the event loop."""
        self.needed: set[str] = set()
        """Names that matter though no path stands on them."""
        self.sent_goals: dict[bytes, None] = {}
        """The ids of goals that the gateway sent, the newest last."""
        self._settled = time.monotonic() + config.grace

    @property
    def settling(self) -> float:
        """Seconds for which the graph is still being discovered."""
        return max(0.0, self._settled - time.monotonic())

    def trouble(self, key: str, detail: str | None) -> None:
        """Note what is wrong with one thing, or that it is well again."""
        if detail is not None:
            self._troubles[key] = detail
        else:
            self._troubles.pop(key, None)

    def report(self) -> None:
        """Report what is wrong, or once that all is well again."""
        detail = "; ".join(self._troubles.values()) or None
        if detail is not None or self._reported:
            self._reported = detail is not None
            self.host.report(detail)

    def sent(self, goal: bytes) -> None:
        """Remember the id of a goal as one of the gateway's own."""
        self.sent_goals[goal] = None
        if len(self.sent_goals) > _GOALS:
            del self.sent_goals[next(iter(self.sent_goals))]

    def complain(self, key: str, detail: str | None) -> None:
        """Note what is wrong, from the ROS thread; only changes are worth a wake-up."""
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
        """Have a function called with each message of a topic; all of it in the ROS thread.

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
        """Wait until something about the graph holds, while that may still be discovered."""
        end = time.monotonic() + seconds
        while not holds():
            if time.monotonic() >= end:
                return False
            await asyncio.sleep(_PAUSE)
        return True

    async def present(self, noun: str, name: str) -> None:
        """Return once somebody offers a thing.

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
    """One resource and the means to serve it; refuses what a subclass does not write."""

    def __init__(self, shared: Shared, resource: Resource, mapping: Mapping) -> None:
        self.shared = shared
        self.resource = resource
        self.mapping = mapping
        self.feedback: Feedback | None = None
        """What measures the motion that it causes, where the mapping says so."""

    @property
    def is_barred(self) -> bool:
        """Whether it moves or energises the robot, and is refused under an e-stop."""
        resource = self.resource
        moves = kind_of(resource.name) in MOVING if resource.moves is None else resource.moves
        return moves or resource.energises

    def admit(self) -> None:
        """Let a command pass that moves or energises; in the ROS thread, just before it is sent.

        :raises EstopActive: the robot was stopped since.
        """
        if not self.is_barred:
            return
        check_fence()
        self.shared.keeper.admit(self.resource.robot)

    @property
    def timeout(self) -> float:
        """Seconds for one answer of the robot."""
        return self.mapping.timeout or self.shared.config.timeout

    async def read(self) -> Any:
        """Return the present value."""
        raise UnsupportedOperation(f"'{self.resource.name}' cannot be read")

    async def write(self, value: Any) -> Any:
        """Bring a value into force."""
        raise UnsupportedOperation(f"'{self.resource.name}' cannot be written")

    async def execute(self, value: Any, progress: Progress) -> Any:
        """Run it to its end."""
        raise UnsupportedOperation(f"'{self.resource.name}' cannot be executed")

    def watched(self, rate: float) -> None:
        """Publish at most so many values a second; infinity: all of them."""

    def unwatched(self) -> None:
        """Publish no more."""

    def placed(self) -> None:
        """Publish what is known, now that the resource is declared."""

    async def halt(self) -> None:
        """Bring to rest what it moves."""

    def close(self) -> None:
        """Let go of what it holds of ROS."""

    def late(self, what: str) -> DeviceTimeout:
        """Say that an answer did not come."""
        return DeviceTimeout(f"{what} did not respond within {self.timeout:g} s")


class Absent(Binding):
    """A mapping that cannot be served now: its type is missing, or not known yet."""

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
    """A path that a construct of ROS brings with it."""

    mapping: Mapping
    """What it stands on."""
    make: Callable[[], Binding]
    """Called in the ROS thread; raises `MissingType`."""


class Construct(Protocol):
    """A convention of ROS that is more than one topic or service: nodes with a lifecycle."""

    def find(self, graph: Graph) -> dict[str, Offer]:
        """Return the paths there are now; on the event loop, at each look at the graph."""
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
