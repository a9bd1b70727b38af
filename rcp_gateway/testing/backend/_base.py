"""What the author of a backend provides to its suite, and the helpers of its tests."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import pytest

from rcp_gateway.testing._client import BOUND, Client, Message
from rcp_gateway.testing._schemas import legal, same
from rcp_gateway.testing._serve import ADMIN, OPERATOR, Served, serve_backend
from rcp_gateway.testing._suite import Suite, eventually
from rcp_kernel.model import BRANCHES, MOVING, Kind, Operation, Resource, full_path
from rcp_kernel.spi import Backend, BackendKind
from rcp_kernel.values import to_plain, value_type
from rcp_protocol.timeouts import timeout

__all__ = ["BackendTests", "Goal", "Robot", "kind_of_resource", "offers"]

_UNGIVEN: Any = msgspec.UNSET


class Goal(msgspec.Struct, frozen=True):
    """Inputs that an action or service is tried with."""

    good: Any
    """It completes."""
    bad: Any = _UNGIVEN
    """It fits the schema, and the robot fails or refuses it; not given: nothing can go wrong."""
    long: Any = _UNGIVEN
    """It takes long enough to be cancelled; `good` if not given."""
    local: bool = False
    """The gateway may complete it without the device, as it only returns what it has already."""

    @property
    def lasting(self) -> Any:
        """The input to cancel."""
        return self.good if self.long is _UNGIVEN else self.long

    @property
    def fails(self) -> bool:
        """Whether there is an input that the robot cannot execute."""
        return self.bad is not _UNGIVEN


def kind_of_resource(resource: Resource) -> Kind:
    """Return the kind that a resource's name says."""
    return Kind(resource.name.partition("/")[0])


def offers(resource: Resource, operation: Operation) -> bool:
    """Tell whether a resource declares an operation."""
    declared = resource.operations
    own = BRANCHES[kind_of_resource(resource)] if declared is None else declared
    return bool(own & operation)


class Robot:
    """The backend under test, in a gateway that runs, with an operator at hand."""

    def __init__(self, served: Served) -> None:
        self.served = served
        self.client: Client = served.client(OPERATOR)

    @property
    def backend(self) -> Backend:
        """The author's backend."""
        return self.served.life.backend

    @property
    def resources(self) -> dict[str, Resource]:
        """The declared resources, by name."""
        return self.served.life.host.resources

    @property
    def faults(self) -> int:
        """Number of invalid values it has published."""
        return self.served.supervisor.faults

    @property
    def last_error(self) -> str | None:
        """Its last fault."""
        return self.served.supervisor.last_error

    def having(self, operation: Operation, *kinds: Kind) -> list[Resource]:
        """List the resources that offer an operation, of some kinds or of all."""
        return [
            resource
            for resource in self.resources.values()
            if offers(resource, operation) and (not kinds or kind_of_resource(resource) in kinds)
        ]

    def path(self, name: str) -> str:
        """Return the full path of one of the backend's names."""
        return full_path("t", None, name)

    async def ask(self, type_: str, name: str, **fields: Any) -> Message:
        """Send the operator's request for one of the backend's names; return the final reply."""
        return await self.client.request(type_, self.path(name), **fields)

    async def begin(self, name: str, value: Any) -> str:
        """Start a command and wait until it is running; return the request's id.

        :raises AssertionError: it ends before it was seen running.
        """
        id_ = await self.client.send(type="execute", path=self.path(name), body=value)
        reply = await self.client.reply(id_)
        assert reply["status"] == "accepted", f"{name} with {value!r}: {reply}"
        return id_


class BackendTests(Suite):
    """Base of the parts of the backend suite: what the author provides."""

    kind: ClassVar[BackendKind]
    """The backend, as its hook offers it."""
    config: ClassVar[Mapping[str, Any]] = {}
    """Its table of the configuration."""
    first_within: ClassVar[float] = 5.0
    """Seconds in which a subscriber has the first value."""
    cancel_within: ClassVar[float] = 5.0
    """Seconds in which a cancelled command has ended and the robot is at rest."""
    complete_within: ClassVar[float] = 20.0
    """Seconds in which a good goal is reached."""

    beside: Sequence[BackendKind] = ()
    """Further backends of the same robot."""
    store: Path | None = None
    """The folder of the gateway's store."""
    device: Any = None
    """The value yielded by `twin`."""
    running: Robot
    """The backend in its gateway; kept after it has closed."""
    prompt: bool
    """Whether it was open when the gateway had started."""

    @property
    def backend(self) -> Any:
        """The backend that was opened last; kept after it has closed."""
        return self.running.backend

    # Provided by the author

    def twin(self) -> AbstractAsyncContextManager[Any]:
        """Run the peer of the backend, if it needs one: a simulated device."""
        return nullcontext()

    def table(self) -> Mapping[str, Any]:
        """Return the table of the configuration; called with the twin running."""
        return self.config

    async def truth(self, name: str) -> Any:
        """Return the value of a writable resource as the device has it, past the gateway."""
        raise NotImplementedError

    async def confirms(self, name: str, result: Any) -> bool:
        """Tell whether the device is in the state that a completed command reports."""
        return same(to_plain(await self.truth(name)), result)

    async def at_rest(self) -> bool:
        """Tell whether nothing of the device moves; by default: its actuators are safe."""
        drives = [r for r in self.running.resources.values() if r.safe is not None]
        if not drives:
            raise NotImplementedError
        return all([same(await self.typed_truth(r), self.safe(r)) for r in drives])

    def goals(self) -> Mapping[str, Goal]:
        """Return a goal for each action, and for those services that have one."""
        return {}

    async def prepare(self, name: str) -> None:
        """Bring the device where the goal of an action can begin; called before each time."""

    def values(self, name: str) -> Sequence[Any]:
        """Return two or more good values of a writable resource, from its examples and schema."""
        resource = self.running.resources[name]
        made = [*resource.examples, *legal(value_type(resource.value).schema)]
        return [value for i, value in enumerate(made) if value not in made[:i]]

    def refusing(self, name: str) -> AbstractAsyncContextManager[None]:
        """Have the device refuse writes of one resource while entered.

        Needed of a backend that writes several as one (`Resource.atomic`).
        """
        raise NotImplementedError

    async def break_link(self) -> None:
        """Cut the link between backend and device."""
        raise NotImplementedError

    async def mend_link(self) -> None:
        """Restore the link."""
        raise NotImplementedError

    # Helpers of the tests

    @property
    def link_breaks(self) -> bool:
        """Whether the author provided `break_link`."""
        own = type(self)
        return (
            own.break_link is not BackendTests.break_link
            or own.mend_link is not BackendTests.mend_link
        )

    @asynccontextmanager
    async def opened(self) -> AsyncGenerator[Robot]:
        """Run a gateway around the backend."""
        async with self.twin() as self.device, self.served_by_device() as robot:
            yield robot

    @asynccontextmanager
    async def served_by_device(self) -> AsyncGenerator[Robot]:
        """Run a gateway around the backend, whose device is already running."""
        async with serve_backend(
            self.kind, self.table(), beside=self.beside, store=self.store
        ) as served:
            self.prompt = served.supervisor.settled.is_set()
            with suppress(TimeoutError):  # late on a busy machine
                async with timeout(BOUND):
                    await served.supervisor.settled.wait()
            assert served.supervisor.name == self.kind.name
            assert served.lives, (
                f"it did not open: {served.supervisor.state}, {served.supervisor.detail}"
            )
            self.running = Robot(served)
            yield self.running

    @pytest.fixture
    async def robot(self) -> AsyncGenerator[Robot]:
        """The backend, open in a gateway, for one test."""
        async with self.opened() as robot:
            yield robot

    def groups(self) -> list[list[Resource]]:
        """List the groups of resources that are written as one, of one robot each."""
        found: dict[tuple[str | None, str], list[Resource]] = {}
        for resource in self.running.having(Operation.WRITE):
            if resource.atomic is not None:
                found.setdefault((resource.robot, resource.atomic), []).append(resource)
        return list(found.values())

    def moving(self) -> list[Resource]:
        """List what moves something."""
        found = self.running.resources.values()
        return [resource for resource in found if kind_of_resource(resource) in MOVING]

    def actions(self) -> list[str]:
        """List the actions that have a goal."""
        return [name for name in self.goals() if name.startswith("action/")]

    async def typed_truth(self, resource: Resource) -> Any:
        """Return the truth of a writable resource, its type's defaults filled in, as plain data."""
        found = to_plain(await self.truth(resource.name))
        return to_plain(value_type(resource.value).convert(found, f"truth of {resource.name}"))

    async def begin(self, name: str) -> str:
        """Start the lasting goal of an action; return the request's id."""
        await self.prepare(name)
        return await self.running.begin(name, self.goals()[name].lasting)

    async def complete(self, name: str, value: Any) -> Message:
        """Run an action or service to its end; return the final reply."""
        await self.prepare(name)
        return await self.running.ask("execute", name, body=value, within=self.complete_within)

    async def set_in_motion(self) -> str | None:
        """Start a command or write a velocity; return the id of a command, if it is one."""
        for name in self.actions():
            return await self.begin(name)
        for resource in self.moving():
            if resource.safe is not None:
                value = self.unsafe(resource)
                done = await self.running.ask("write", resource.name, body=value)
                assert done["status"] == "completed", done
                return None
        return pytest.skip("nothing of it moves")

    def safe(self, resource: Resource) -> Any:
        """Return the safe value of an actuator as plain data."""
        return to_plain(value_type(resource.value).convert(to_plain(resource.safe)))

    def unsafe(self, resource: Resource) -> Any:
        """Return a value of an actuator that moves it."""
        convert, safe = value_type(resource.value).convert, self.safe(resource)
        return next(v for v in self.values(resource.name) if not same(to_plain(convert(v)), safe))

    async def comes_to_rest(self, why: str) -> None:
        """Wait until nothing moves."""
        await eventually(self.at_rest, f"at rest after {why}", self.cancel_within)

    def admin(self) -> Client:
        """Connect a client with all rights."""
        return self.running.served.client(ADMIN)
