"""The ROS thread: one executor, one node with its context, and further ones for names with several types.

rclpy is imported here and never used on the event loop. Functions run in this thread by `call` or
`post`; results return through `Host.call_soon`.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections import deque
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from contextvars import Context, copy_context
from typing import Any

import structlog

from rcp_kernel.errors import AdapterUnavailable, ConfigError, DeviceTimeout, NotReady, StartupError
from rcp_kernel.spi import Host
from rcp_protocol.timeouts import timeout
from rcp_ros2.config import Ros2Config
from rcp_ros2.middleware import check_middleware
from rcp_ros2.shared_memory import remove_half_made

__all__ = ["Once", "Ros", "Ticket", "contained", "one_argument", "open_ros"]

log = structlog.get_logger("rcp.ros2")
_START = 15.0  # s to import rclpy and create a node, on a slow machine
_STOP = 5.0  # s for the executor to end
_FOREVER = 1e7  # s; the events executor runs nothing in `spin()`, but does with a time-out
_PATIENCE = 5.0  # s for a function to be run in the thread


class Ticket:
    """A value that the ROS thread passes to one waiter on the event loop, at most once."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._future: asyncio.Future[Any] = asyncio.get_running_loop().create_future()

    def give(self, value: Any) -> None:
        """Pass the value, from any thread."""
        try:
            self._host.call_soon(self._set, value, None)
        except RuntimeError:  # the event loop is closed: nobody waits
            return

    def fail(self, error: BaseException) -> None:
        """Pass an exception, from any thread."""
        with contextlib.suppress(RuntimeError):
            self._host.call_soon(self._set, None, error)

    def follow(self, ros_future: Any, convert: Callable[[Any], Any] | None = None) -> None:
        """Pass on the result of an rclpy future, converted in the ROS thread."""

        def done(future: Any) -> None:
            try:
                if not future.cancelled():
                    value = future.result()
                    self.give(value if convert is None else convert(value))
            except Exception as error:
                self.fail(error)

        ros_future.add_done_callback(done)

    def _set(self, value: Any, error: BaseException | None) -> None:
        if self._future.done():
            return
        if error is not None:
            self._future.set_exception(error)
            self._future.exception()  # retrieved: the waiter may have been cancelled by a stop
        else:
            self._future.set_result(value)

    def refuse(self, error: BaseException) -> None:
        """Raise an exception in the waiter; for the event loop."""
        self._set(None, error)

    @property
    def done(self) -> bool:
        """Whether the value is available."""
        return self._future.done()

    async def answer(self) -> Any:
        """Wait for the value, and return it or raise the exception.

        Who is cancelled meanwhile gives the ticket up: what comes later is dropped.
        """
        return await self._future

    async def wait(self, seconds: float) -> bool:
        """Wait at most `seconds`; return whether the value is available."""
        await asyncio.wait([self._future], timeout=seconds)
        return self._future.done()

    def result(self) -> Any:
        """Return the value, or raise the exception."""
        return self._future.result()


class Once:
    """Something that is either begun by the ROS thread or given up by the event loop."""

    def __init__(self) -> None:
        self._left = [None]

    def take(self) -> bool:
        """Return whether the caller is the first."""
        try:
            self._left.pop()  # atomic: both may come at the same time
        except IndexError:
            return False
        return True


class Ros:
    """The thread's interface for the event loop; only the thread uses `node` and `executor`."""

    def __init__(self, config: Ros2Config, host: Host) -> None:
        self.config = config
        self.host = host
        self.node: Any = None
        self.died: str | None = None
        self.ended = asyncio.Event()
        """Set when the thread has ended, intentionally or not."""
        self.on_close: list[Callable[[], None]] = []
        """Called in the thread before the node is destroyed, for what would keep it."""
        self._contexts: list[Any] = []
        self._nodes: list[Any] = []
        self._executor: Any = None
        self._stop: Any = None
        self._submitted: deque[tuple[Context, Callable[..., None], tuple[Any, ...]]] = deque()
        self._woken = False
        """Whether the executor was told that there is something submitted."""
        self._thread = threading.Thread(target=self._run, name="ros2", daemon=True)
        self._ready = Ticket(host)

    # -- for the event loop ----------------------------------------------------------------------

    async def start(self) -> None:
        """Start the thread and wait until its node exists."""
        self._thread.start()
        if not await self._ready.wait(_START):
            raise NotReady(f"ROS 2 did not start within {_START:g} s")
        self._ready.result()

    async def stop(self) -> None:
        """Stop the executor, and destroy the node and context."""
        if self._stop is not None and self._thread.is_alive():
            self._executor.create_task(self._stop.set_result, None)
            self._executor.wake()
        try:
            async with timeout(_STOP):
                await self.ended.wait()
        except TimeoutError:
            log.error("ros_thread_stuck", node=self.config.node)
            return
        self._thread.join(_STOP)

    async def call(self, function: Callable[..., Any], *args: Any) -> Any:
        """Run a function in the thread and return its result.

        What the thread has not begun in time is never run: nobody would expect it any more.

        :raises DeviceTimeout: the thread did not run it in time.
        :raises AdapterUnavailable: the thread has ended.
        """
        ticket, once = Ticket(self.host), Once()

        def run() -> None:
            if not once.take():
                return
            try:
                ticket.give(function(*args))
            except BaseException as error:
                ticket.fail(error)

        self.submit(run)
        if await ticket.wait(_PATIENCE):
            return ticket.result()
        what = "nothing was sent to the robot" if once.take() else "the robot may have acted"
        raise DeviceTimeout(
            f"the gateway's ROS 2 thread did not respond for {_PATIENCE:g} s",
            remedy=f"Check the gateway's log and load; {what}.",
        )

    def post(self, function: Callable[..., Any], *args: Any) -> None:
        """Run a function in the thread soon; its errors are logged.

        Does nothing once the thread has ended: everything has been released.
        """
        with contextlib.suppress(AdapterUnavailable):
            self.submit(contained(function, *args))

    def submit(self, run: Callable[..., None], *args: Any) -> None:
        """Run a function that never raises in the thread.

        What is submitted before the thread has woken shares one task of the executor.

        :raises AdapterUnavailable: the thread has ended.
        """
        if self.died is not None or self._executor is None:
            raise AdapterUnavailable(self.died or "ROS 2 is not running")
        # Keep the request's context, for `check_fence` just before something is sent.
        self._submitted.append((copy_context(), run, args))
        if not self._woken:
            self._woken = True
            self._executor.create_task(self._run_submitted)

    # -- the thread ------------------------------------------------------------------------------

    def _run_submitted(self) -> None:
        self._woken = False  # first: what is submitted from now on wakes the executor again
        for _ in range(len(self._submitted)):
            context, run, args = self._submitted.popleft()
            context.run(run, *args)

    def _run(self) -> None:
        try:
            self._open()
        except BaseException as error:
            self.died = str(error)
            self._close()
            self._ready.fail(_explained(error))
            self._report_end()
            return
        self._ready.give(None)
        try:
            self._executor.spin_until_future_complete(self._stop, timeout_sec=_FOREVER)
        except BaseException as error:
            log.error("ros_thread_failed", exc_info=error)
            self.died = f"the executor of ROS 2 failed: {error}"
        else:
            self.died = "ROS 2 was shut down"
        self._close()
        self._report_end()

    def _report_end(self) -> None:
        with contextlib.suppress(RuntimeError):
            self.host.call_soon(self.ended.set)

    def _open(self) -> None:
        check_middleware()
        remove_half_made()
        from rclpy.task import Future

        self.node = self._new_node(self.config.node)
        self._executor = _executor(self.node.context)
        self._executor.add_node(self.node)
        self._stop = Future()

    def add_node(self, suffix: str) -> Any:
        """Create another node for the rest of the thread's life, with a context of its own; in the thread.

        The middleware has one type of each name in a context.
        """
        node = self._new_node(f"{self.config.node}_{suffix}")
        self._executor.add_node(node)
        return node

    def _new_node(self, name: str) -> Any:
        import rclpy
        from rclpy.context import Context

        context = Context()
        self._contexts.append(context)
        enclave = self.config.enclave
        arguments = [] if enclave is None else ["--ros-args", "--enclave", enclave]
        rclpy.init(args=arguments, context=context, domain_id=self.config.domain_id)
        node = rclpy.create_node(
            name,
            context=context,
            namespace=self.config.namespace,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._nodes.append(node)
        return node

    def _close(self) -> None:
        if self._executor is not None:
            for node in self._nodes:
                _try(self._executor.remove_node, node)
        for release in self.on_close:
            _try(release)
        for node in self._nodes:
            _try(node.destroy_node)
        if self._executor is not None:
            _try(self._executor.shutdown)
        for context in self._contexts:
            _try(context.try_shutdown)


def _try(step: Callable[..., Any], *args: Any) -> None:
    try:
        step(*args)
    except Exception as error:
        log.warning("ros_close_failed", error=repr(error))


def _executor(context: Any) -> Any:
    """Create the events executor, four times as fast as the others, if this rclpy has it."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor

        return EventsExecutor(context=context)
    except (ImportError, OSError, ValueError, RuntimeError):
        from rclpy.executors import SingleThreadedExecutor

        return SingleThreadedExecutor(context=context)


def _explained(error: BaseException) -> BaseException:
    name = type(error).__name__
    if isinstance(error, StartupError):
        return error
    if isinstance(error, ImportError):
        return ConfigError(
            f"ROS 2 is not available ({error}): pip install 'rcp-gateway[ros2]', or source a ROS 2 "
            "installation (source /opt/ros/<distro>/setup.bash) before the gateway starts"
        )
    if name in ("InvalidNodeNameException", "InvalidNamespaceException"):
        return ConfigError(f"the gateway's node cannot have this name: {error}")
    return NotReady(f"ROS 2 did not start: {error}")


def contained(function: Callable[..., Any], *args: Any) -> Callable[[], None]:
    """Wrap a callback: an exception that escaped would end the executor."""

    def run() -> None:
        try:
            function(*args)
        except Exception as error:
            log.error("ros_callback_failed", callback=function.__qualname__, exc_info=error)

    return run


def one_argument(function: Callable[[Any], Any]) -> Callable[[Any], None]:
    """Wrap a one-argument callback; rclpy inspects the signature and passes more to others."""

    def run(message: Any) -> None:
        contained(function, message)()

    return run


@asynccontextmanager
async def open_ros(config: Ros2Config, host: Host) -> AsyncGenerator[Ros]:
    """Keep a ROS thread running; if it dies, the body is cancelled.

    :raises ConfigError: rclpy is missing, or a name is invalid.
    :raises NotReady: ROS 2 did not start, or failed later.
    """
    ros = Ros(config, host)
    await ros.start()
    owner = asyncio.current_task()
    assert owner is not None

    async def watch() -> None:
        await ros.ended.wait()
        owner.cancel()

    watcher = asyncio.create_task(watch(), name="ros2 thread")
    try:
        yield ros
    except asyncio.CancelledError:
        if ros.ended.is_set() and owner.uncancel() == 0:
            raise NotReady(ros.died or "ROS 2 ended") from None
        raise
    finally:
        watcher.cancel()
        await ros.stop()
