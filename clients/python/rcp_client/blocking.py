"""The client for scripts without asyncio: the same methods, each blocking until its reply.

The asyncio client runs on an event loop in a separate thread, so that the connection is maintained
while the script does other work.
"""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Generator, Iterable, Mapping, Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Any, ParamSpec, Self, TypeVar

from anyio.from_thread import BlockingPortal, start_blocking_portal

from rcp_client.client import Client
from rcp_client.command import CommandHandle, Feedback
from rcp_client.connection import connect
from rcp_client.lease import Lease
from rcp_client.messages import Notice, Reply, ResourceInfo, Update
from rcp_client.subscription import Subscription
from rcp_protocol.errors import LeaseLost

__all__ = ["BlockingCommand", "BlockingLease", "BlockingSubscription", "Robot"]

P = ParamSpec("P")
T = TypeVar("T")


class Robot:
    """A session with a gateway; arguments and errors as for `rcp_client.connect`.

    May be used from several threads. Callbacks run on the client's own thread.
    """

    def __init__(self, url: str | None = None, **options: Any) -> None:
        self._client: Client = connect(url, **options)
        self._stack = ExitStack()
        self._portal: BlockingPortal | None = None

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._portal = stack.enter_context(start_blocking_portal("asyncio"))
            stack.enter_context(self._portal.wrap_async_context_manager(self._client))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        type_: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.__exit__(type_, error, trace)
        self._portal = None

    def _do(
        self,
        method: Callable[P, Coroutine[Any, Any, T]],
        *args: P.args,
        **kwargs: P.kwargs,
    ) -> T:
        if self._portal is None:
            raise RuntimeError("use the robot inside its `with` block")

        async def run() -> T:
            return await method(*args, **kwargs)

        future = self._portal.start_task_soon(run)
        try:
            return future.result()
        except BaseException:  # Ctrl-C in the script: cancel the request as well
            future.cancel()
            raise

    def read(self, path: str, **options: Any) -> Any:
        """See `Client.read`."""
        return self._do(self._client.read, path, **options)

    def pages(self, pattern: str, **options: Any) -> Generator[list[dict[str, Any]]]:
        """See `Client.pages`."""
        return _blocking(self._do, lambda: self._client.pages(pattern, **options))

    def sample(self, path: str, **options: Any) -> Reply:
        """See `Client.sample`."""
        return self._do(self._client.sample, path, **options)

    def write(self, path: str, value: Any, **options: Any) -> Any:
        """See `Client.write`."""
        return self._do(self._client.write, path, value, **options)

    def write_all(self, values: Mapping[str, Any], **options: Any) -> dict[str, Any]:
        """See `Client.write_all`."""
        return self._do(self._client.write_all, values, **options)

    def execute(self, path: str, input: Any = None, **options: Any) -> Any:  # noqa: A002
        """See `Client.execute`."""
        return self._do(self._client.execute, path, input, **options)

    def start(self, path: str, input: Any = None, **options: Any) -> BlockingCommand:  # noqa: A002
        """See `Client.start`."""
        return BlockingCommand(self._do, self._do(self._client.start, path, input, **options))

    def plan(
        self, plan: str | Sequence[Mapping[str, Any]] | Mapping[str, Any], **options: Any
    ) -> list[dict[str, Any]]:
        """See `Client.plan`."""
        return self._do(self._client.plan, plan, **options)

    def approve(self, approval: str, **options: Any) -> dict[str, Any]:
        """See `Client.approve`."""
        return self._do(self._client.approve, approval, **options)

    def approvals(self) -> list[dict[str, Any]]:
        """See `Client.approvals`."""
        return self._do(self._client.approvals)

    def cancel(self, command: str) -> list[str]:
        """See `Client.cancel`."""
        return self._do(self._client.cancel, command)

    def commands(self) -> list[dict[str, Any]]:
        """See `Client.commands`."""
        return self._do(self._client.commands)

    def estop(self, **options: Any) -> dict[str, Any]:
        """See `Client.estop`."""
        return self._do(self._client.estop, **options)

    def hold(self, robot: str | None = None, **options: Any) -> dict[str, Any]:
        """See `Client.hold`."""
        return self._do(self._client.hold, robot, **options)

    def lease(self, scope: str, **options: Any) -> BlockingLease:
        """See `Client.lease`; use it in a `with` statement."""
        return BlockingLease(self._do, self._client.lease(scope, **options))

    def robots(self, q: str | None = None) -> list[dict[str, Any]]:
        """See `Client.robots`."""
        return self._do(self._client.robots, q)

    def leases(self) -> list[dict[str, Any]]:
        """See `Client.leases`."""
        return self._do(self._client.leases)

    def subscribe(self, patterns: str | Iterable[str], **options: Any) -> BlockingSubscription:
        """See `Client.subscribe`; iterate over it, or use it in a `with` statement."""

        async def make() -> Subscription:
            return self._client.subscribe(patterns, **options)

        return BlockingSubscription(self._do, self._do(make))

    def discover(self, pattern: str | None = None, **options: Any) -> list[ResourceInfo]:
        """See `Client.discover`."""
        return self._do(self._client.discover, pattern, **options)

    def status(self) -> dict[str, Any]:
        """See `Client.status`."""
        return self._do(self._client.status)

    def ping(self) -> float:
        """See `Client.ping`."""
        return self._do(self._client.ping)

    def batch(self, envelopes: Sequence[dict[str, Any]]) -> list[Reply]:
        """See `Client.batch`."""
        return self._do(self._client.batch, envelopes)

    def request(self, envelope: dict[str, Any]) -> Reply:
        """See `Client.request`."""
        return self._do(self._client.request, envelope)


class BlockingCommand:
    """A running command; iterate over it for its feedback."""

    def __init__(self, do: Callable[..., Any], handle: CommandHandle) -> None:
        self._do = do
        self._handle = handle

    @property
    def id(self) -> str | None:
        """The gateway's id of the command."""
        return self._handle.id

    @property
    def status(self) -> str:
        """The last received status."""
        return self._handle.status

    def __iter__(self) -> Generator[Feedback]:
        return _blocking(self._do, self._handle.__aiter__)

    def result(self) -> Any:
        """Wait for the end and return the result; see `CommandHandle.result`."""
        return self._do(self._handle.result)

    def cancel(self) -> Reply:
        """Request cancellation; the robot is told to stop the command."""
        return self._do(self._handle.cancel)


class BlockingLease:
    """Exclusive control during a `with` block, which it cannot interrupt.

    If the lease is lost, leaving the block raises `LeaseLost`; call `check` to find out earlier.
    The gateway refuses commands of the block in the meantime.
    """

    def __init__(self, do: Callable[..., Any], lease: Lease) -> None:
        self._do = do
        self._lease = lease

    def __enter__(self) -> Self:
        self._do(self._lease.open)
        return self

    def __exit__(self, type_: type[BaseException] | None, *_: object) -> None:
        self._do(self._lease.close)
        if type_ is None:
            self._lease.check()

    @property
    def facts(self) -> dict[str, Any]:
        """See `Lease.facts`."""
        return self._lease.facts

    @property
    def lost(self) -> LeaseLost | None:
        """Why the lease was lost, once it is."""
        return self._lease.lost

    def check(self) -> None:
        """See `Lease.check`."""
        self._lease.check()

    def hand_over(self, to: str) -> dict[str, Any]:
        """See `Lease.hand_over`."""
        return self._do(self._lease.hand_over, to)


class BlockingSubscription:
    """A subscription; see `Subscription`."""

    def __init__(self, do: Callable[..., Any], subscription: Subscription) -> None:
        self._do = do
        self._subscription = subscription

    def __enter__(self) -> Self:
        self._do(self._subscription.__aenter__)
        return self

    def __exit__(self, *_: object) -> None:
        self._do(self._subscription.__aexit__)

    def __iter__(self) -> Generator[Update]:
        return _blocking(self._do, self._subscription.__aiter__)

    def events(self) -> Generator[Update | Notice]:
        """Iterate over updates and notices in the order of arrival."""
        return _blocking(self._do, self._subscription.events)


def _blocking(do: Callable[..., Any], begin: Callable[[], Any]) -> Generator[Any]:
    """Run an asynchronous generator entirely on the client's thread."""

    async def make() -> Any:
        return begin()

    items = do(make)

    async def following() -> tuple[bool, Any]:
        async for item in items:
            return True, item
        return False, None

    async def end() -> None:
        await items.aclose()

    try:
        while True:
            more, item = do(following)
            if not more:
                return
            yield item
    finally:
        do(end)
