"""Bindings of paths to ROS: the common part of topics, services, actions and parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from rcp_kernel.errors import AdapterUnavailable, DeviceTimeout, UnsupportedOperation
from rcp_kernel.model import MOVING, Resource, kind_of
from rcp_kernel.spi import Host, Progress, check_fence
from rcp_ros2.config import Mapping, Ros2Config
from rcp_ros2.feedback import Feedback
from rcp_ros2.graph import Graph
from rcp_ros2.keeper import Keeper
from rcp_ros2.link import RosLink
from rcp_ros2.ros import Ros

__all__ = ["Absent", "Binding", "Construct", "Offer", "Shared", "common"]


class Shared(RosLink):
    """The shared collaborators of all bindings: the connection, and what keeps robots stopped."""

    def __init__(self, ros: Ros, config: Ros2Config, host: Host) -> None:
        super().__init__(ros, config, host)
        self.keeper = Keeper(self)


class Binding:
    """One resource and its implementation; operations it does not override are refused."""

    def __init__(self, shared: Shared, resource: Resource, mapping: Mapping) -> None:
        self.shared = shared
        self.resource = resource
        self.mapping = mapping
        self.feedback: Feedback | None = None
        """Feedback of the motion that the resource causes, if mapped."""
        self.standard: str | None = None
        """The name of the profiles' resource that it is."""

    @property
    def is_barred(self) -> bool:
        """Whether it moves or energises the robot, and is refused under an e-stop."""
        resource = self.resource
        moves = kind_of(resource.name) in MOVING if resource.moves is None else resource.moves
        return moves or resource.energises

    def admit(self) -> None:
        """Check a command that moves or energises; called in the ROS thread just before sending.

        :raises EstopActive: the robot has been stopped since the request.
        """
        if not self.is_barred:
            return
        check_fence()
        self.shared.keeper.admit(self.resource.robot)

    @property
    def timeout(self) -> float:
        """Time-out in s for one response from the robot."""
        return self.mapping.timeout or self.shared.config.timeout

    async def read(self) -> Any:
        """Return the current value."""
        raise UnsupportedOperation(f"'{self.resource.name}' cannot be read")

    async def measured(self) -> tuple[Any, int | None]:
        """Return the current value and its source time in ns, None for the time of receipt."""
        return await self.read(), None

    async def write(self, value: Any) -> Any:
        """Write a value."""
        raise UnsupportedOperation(f"'{self.resource.name}' cannot be written")

    async def execute(self, value: Any, progress: Progress) -> Any:
        """Run the service or action to its end."""
        raise UnsupportedOperation(f"'{self.resource.name}' cannot be executed")

    def watched(self, rate: float) -> None:
        """Publish at most `rate` values per second; infinity publishes all of them."""

    def unwatched(self) -> None:
        """Stop publishing."""

    def placed(self) -> None:
        """Publish values received before the resource was declared."""

    async def halt(self) -> None:
        """Stop the motion that the resource causes."""

    def close(self) -> None:
        """Release its ROS entities."""

    def late(self, what: str) -> DeviceTimeout:
        """Return the error for a missing response from `what`."""
        return DeviceTimeout(f"{what} did not respond within {self.timeout:g} s")


class Absent(Binding):
    """A mapping that is not available: its type is missing or unknown so far."""

    def __init__(
        self, shared: Shared, resource: Resource, mapping: Mapping, why: str, remedy: str
    ) -> None:
        super().__init__(shared, resource, mapping)
        self.why = why
        self._remedy = remedy

    def _error(self) -> AdapterUnavailable:
        return AdapterUnavailable(self.why, remedy=self._remedy)

    async def read(self) -> Any:
        """Raise the reason."""
        raise self._error()

    async def write(self, value: Any) -> Any:
        """Raise the reason."""
        raise self._error()

    async def execute(self, value: Any, progress: Progress) -> Any:
        """Raise the reason."""
        raise self._error()


class Offer(NamedTuple):
    """A path provided by a ROS convention."""

    mapping: Mapping
    """Target of the path."""
    make: Callable[[], Binding]
    """Creates the binding; called in the ROS thread, raises `MissingType`."""
    key: str = ""
    """What it is made of: a binding of another key is replaced."""


class Construct(Protocol):
    """A ROS convention of several topics or services, such as lifecycle nodes."""

    def find(self, graph: Graph) -> dict[str, Offer]:
        """Return the current paths; called on the event loop after each poll of the graph."""
        ...


def common(name: str, mapping: Mapping, description: str, **facts: Any) -> dict[str, Any]:
    """Return the `Resource` arguments that every kind of mapping shares."""
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
