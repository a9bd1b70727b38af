"""The interfaces that backends implement, and those that they receive.

A plugin for robots registers `BackendKind` records and derives from `Backend`; its backend uses the
gateway only through `Host`. Hooks declare, context managers run, method calls do the work. The
interface of transports and adapters is in `rcp_gateway`: `client_kinds` and `client_api`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, nullcontext
from typing import Any, Protocol

import msgspec

from rcp_kernel.contract.caller import Caller, caller
from rcp_kernel.contract.fence import check_fence, fenced_off, is_commanded, unfenced
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.robots import (
    Anchor,
    Dimensions,
    Encoded,
    FrameTree,
    FrameWatch,
    MotionState,
    Native,
    OwnLeases,
    Progress,
    Publication,
    RobotFacts,
    RobotLease,
    RobotLeaseRequest,
    RobotLink,
    StopPlan,
    Watchdog,
)
from rcp_kernel.errors import RcpError, UnsupportedOperation
from rcp_kernel.model import Resource

__all__ = [
    "Anchor",
    "Backend",
    "BackendKind",
    "BaseBackend",
    "Caller",
    "Dimensions",
    "Encoded",
    "Exclusive",
    "FrameTree",
    "FrameWatch",
    "Host",
    "MotionState",
    "Native",
    "OwnLeases",
    "Principal",
    "Progress",
    "Publication",
    "RobotFacts",
    "RobotLease",
    "RobotLeaseRequest",
    "RobotLink",
    "StopPlan",
    "Watchdog",
    "caller",
    "check_fence",
    "fenced_off",
    "is_commanded",
    "unfenced",
]


class Host(Protocol):
    """The interface that a backend receives: the tree below its tenant and robot.

    Names are the backend's own (`sensor/pose`). Every method is for the event loop's thread except
    `call_soon` and `publish_batch`.
    """

    tenant: str
    robot: str | None

    def declare(self, *resources: Resource) -> None:
        """Add resources, or replace those of the same name.

        :raises PluginError: if a name is taken by another backend, or a type has no schema.
        """
        ...

    def withdraw(self, *names: str) -> None:
        """Remove resources and notify their commands and subscriptions, if they exist."""
        ...

    def publish(self, name: str, value: Any, timestamp: int | None = None) -> None:
        """Publish a new value; never blocks; an invalid value is a fault, not an exception."""
        ...

    def publish_batch(self, batch: Sequence[Publication]) -> None:
        """Hand over values from any thread, with one wake-up of the event loop for all of them."""
        ...

    def call_soon(self, function: Callable[..., object], *args: Any) -> None:
        """Run a function on the event loop, from any thread."""
        ...

    def report(self, detail: str | None, *, down: bool = False, robot: str | None = None) -> None:
        """Report that the link is degraded (or down), with the reason; None: it has recovered.

        With `robot`, of one of the backend's robots (see `Resource.robot`): the others are not
        touched.
        """
        ...

    def link_restored(self, robot: str | None = None) -> None:
        """Report that a lost robot is connected again, before anything else is sent to it.

        A robot under a latched e-stop gets the stop at once, from within this call. For one whose
        command was lost with the link, `Backend.recover` is called soon.
        """
        ...

    def is_latched(self, robot: str | None = None) -> bool:
        """Return whether an e-stop holds one of the backend's robots, or the backend as a whole."""
        ...

    def own_estop(
        self, robot: str, state: Mapping[str, Any] | None, *, reset: bool = False
    ) -> None:
        """Report the latched e-stop of a robot's own gateway, as in `/system/estop`.

        None: it is not latched. With `reset`, because somebody has reset it there: then this
        gateway does not hold the robot any longer either. See `Backend.has_gateways`.
        """
        ...

    def own_leases(self, robot: str, leases: OwnLeases | None) -> None:
        """Report who holds leases on a robot, as its own gateway says; None: it cannot be asked.

        See `Backend.has_gateways`.
        """
        ...

    def refused(self, error: RcpError, *, count: int = 1) -> None:
        """Report, for the audit log, that a peer of the backend was refused `count` times.

        For backends whose robots connect to them.
        """
        ...

    def guard(self, name: str, plan: StopPlan | None) -> None:
        """Give the guard process a plan that stops a part of the robot without the gateway.

        It replaces a plan of the same name; None removes that.
        """
        ...

    def describe(self, facts: RobotFacts, robot: str | None = None) -> None:
        """Describe one of the backend's robots (None: the backend as a whole).

        Called again when more is known, such as the firmware; it replaces the earlier description.
        """
        ...

    def anchor(self, anchor: Anchor | None, robot: str | None = None) -> None:
        """Report where one of a robot's frames is fixed to the earth; None: no longer known.

        Called again when it changes. The gateway then converts between that frame and `earth`.
        """
        ...

    def transforms(self, tree: FrameTree, robot: str | None = None) -> None:
        """Give the transforms between a robot's frames.

        Not needed for those that `sensor/pose` and `sensor/odometry` already give.
        """
        ...

    def discovering(self, *, active: bool) -> None:
        """Report whether the backend is still discovering resources.

        Until discovery is finished, requests for paths that it could have are refused as retryable.
        Not needed before the backend is open.
        """
        ...


class Backend:
    """A robot, as the kernel sees it. Every name is one the backend declared itself.

    A plugin derives from it, under its name `BaseBackend`, and overrides what its robot has: the
    methods here refuse, or do what is right for a robot that lacks the function.

    All coroutines run on the event loop and may be cancelled at any await: deadlines and clients'
    cancels arrive as cancellation. Arguments already match the declared types. Exceptions should be
    `RcpError`s; any other becomes `internal`.
    """

    on_loss: str = "hold"
    """Policy for a robot whose command was lost with its link: `hold`, `continue`, `land`,
    `return`. Included in the command's error; `recover` applies it."""

    has_gateways: bool = False
    """Whether each of its robots has a gateway of its own, as in a fleet.

    Then commands and stops are the robots' own: closing this gateway neither halts them nor cancels
    their commands. A robot that is down does not end its commands here: `execute` waits for it, up to
    their deadline. A command that an earlier run of the gateway began, or an earlier opening of the
    backend, is passed to `execute` again with the same `caller().key`, under which the robot's
    gateway answers with what it knows of it. No dead-man is armed here: pass `caller().valid_for` on."""

    async def read(self, name: str) -> Any:
        """Return the current value, or a `Publication` of it with its source time.

        Called only if no fresh sample is available. By default, only published values exist.

        :raises AdapterUnavailable: the link is down.
        :raises DeviceTimeout: the robot did not respond.
        :raises UnsupportedOperation: the value cannot be requested, only subscribed to; the kernel
            then waits for the first sample.
        """
        raise UnsupportedOperation(f"'{name}' cannot be read")

    async def read_in_frame(self, name: str, frame: str) -> Any:
        """Return the current value in a frame, as the robot's own gateway converts it: `Encoded`.

        Called only on a backend that `has_gateways`.

        :raises FilterUnsupported, InvalidValue, PreconditionFailed: that gateway refuses it.
        """
        raise UnsupportedOperation(f"'{name}' cannot be read in a frame")

    def frames_of(self, name: str) -> Sequence[str]:
        """Return the frames of a resource, as the robot's own gateway listed them: no I/O.

        Called only on a backend that `has_gateways`.
        """
        return ()

    def watch_in_frame(self, name: str, watch: FrameWatch) -> Callable[[], None]:
        """Have the robot's own gateway send a resource's values in a frame; return the end function.

        Called only on a backend that `has_gateways`. It goes on over interruptions, and waits for a
        robot that is not there yet, until it is ended; `missing` gets the reason why nothing comes.
        """
        raise UnsupportedOperation(f"'{name}' cannot be subscribed to in a frame")

    async def write(self, name: str, value: Any) -> Any:
        """Bring a value into force; return the value now in force, or None if it is `value`.

        :raises DeviceRejected: the robot refused, with its reason.
        """
        raise UnsupportedOperation(f"'{name}' cannot be written")

    async def write_together(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """Bring several values into force at the same moment, or none of them.

        Called only for names of one group (`Resource.atomic`), also with their safe values. Return
        the values now in force that differ from those sent. Check everything that may be refused
        before the first one is sent: `DeviceRejected` and the errors of a refusal mean that none is
        in force. After any other error, and after a cancellation, the kernel brings all of them to
        rest. `path` of an error is the name of the one that it is about.

        :raises DeviceRejected: the robot refused, and none of them is in force.
        """
        raise UnsupportedOperation("the backend cannot write several values as one")

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Run an action or service to its end and return its result.

        Returning means that the robot confirmed it. A cancellation must reach the robot before
        the coroutine ends.

        :raises DeviceRejected: the robot refused or aborted.
        """
        raise UnsupportedOperation(f"'{name}' cannot be executed")

    def foresee(self, name: str, value: Any) -> None:
        """Refuse a dry run of what `execute` would refuse now, as far as the backend knows.

        Called on the event loop: it sends nothing to the robot, and must be fast.

        :raises RcpError: as `execute` would.
        """

    def watch(self, name: str, rate: float | None) -> AbstractAsyncContextManager[object]:
        """Keep `name` published while entered; `rate` is the highest requested rate, in Hz.

        Entered at the first subscriber and left after the last. When the requested rate changes,
        the new context is entered before the old one is left. None: as fast as the source provides.
        By default, everything is published without subscribers.
        """
        return nullcontext()

    async def halt(self) -> None:
        """Bring everything that moves to rest at once, by the strongest effective means.

        Return when it is *measured* to be at rest; a robot that cannot be reached is an error,
        never a success. Called by the e-stop until the robot is confirmed at rest, and before the
        backend closes until one call returns; also while an earlier call is still waiting, whose
        commands may have been lost. By default, nothing moves.

        :raises AdapterUnavailable: a robot cannot be reached.
        :raises DeviceTimeout: it was commanded to stop and does not come to rest.
        """

    async def halt_robot(self, robot: str) -> None:
        """Bring one of several robots to rest, as `halt` does all (the default): see `Resource.robot`."""
        await self.halt()

    def motion(self, robot: str | None) -> MotionState | None:
        """Report whether a robot (None: all of the backend) is at rest, by measurement.

        Called often while an e-stop is latched: no I/O. None: this backend measures nothing, and a
        `halt` that returned is all that can be known.
        """
        return None

    def hold_stop(self, robot: str | None) -> None:
        """Send again, without waiting, what keeps a robot (None: all) stopped.

        Called ten times a second while an e-stop is latched, also before the first confirmation
        and at once when the link returns. By default, a robot at rest stays there.
        """

    async def hold(self, robot: str | None) -> None:
        """Bring a robot (None: all) to rest without an e-stop: brake, hover, keep the position.

        The verb `service/hold` that every robot has; return when it is measured to be at rest. By
        default, it stops as for the e-stop.
        """
        await (self.halt() if robot is None else self.halt_robot(robot))

    async def recover(self, robot: str | None) -> str:
        """Apply `on_loss` after the link has returned; return what was done.

        Called once for a robot whose command ended with its link, or with an earlier gateway.
        """
        await self.hold(robot)
        return "held"

    async def reset_estop(self, robot: str | None) -> None:
        """Ask a robot's own gateway (None: all) to reset its e-stop; see `has_gateways`.

        Called after an e-stop was reset here, by the principal of `caller()`. A robot whose gateway
        refuses, or cannot be reached, is latched here again.

        :raises RcpError: it refuses.
        """

    async def lease(self, robot: str, request: RobotLeaseRequest) -> RobotLease:
        """Ask a robot's own gateway for a lease, for the principal of `caller()`; see `has_gateways`.

        Return the lease as it is after the request.

        :raises LeaseHeld, LeaseLost, LeaseRequired: its gateway reports this.
        :raises RcpError: it refuses, or cannot be reached.
        """
        raise UnsupportedOperation(f"'{robot}' has no gateway of its own")

    def watchdogs(self) -> Sequence[Watchdog]:
        """List what stops the robots when the gateway falls silent, as verified on the device."""
        return ()

    def robot_link(self, robot: str) -> RobotLink | None:
        """Report what the link with a robot's own gateway carries, if there ever was one.

        Called only on a backend that `has_gateways`, for each robot at each scrape of `/metrics`: no
        I/O.
        """
        return None


BaseBackend = Backend
"""The name under which plugins derive from it."""


def has_watch(backend: Backend) -> bool:
    """Return whether a backend, contained or not, implements `watch`."""
    inner: object = getattr(backend, "inner", backend)
    return getattr(type(inner), "watch", None) not in (None, BaseBackend.watch)


class Exclusive(msgspec.Struct, frozen=True):
    """Something of this machine that only one backend can have open."""

    link: str
    """As the configuration writes it."""
    name: str
    """Of the port or device, the same for all who mean it."""
    host: str | None = None
    """The address of a port; `0.0.0.0` and `::` are all of their family, `*` is all. None: it has none."""

    def overlaps(self, other: Exclusive) -> bool:
        """Return whether both cannot be open at once."""
        if self.name != other.name:
            return False
        return self.host == other.host or self._covers(other) or other._covers(self)

    def _covers(self, other: Exclusive) -> bool:
        every = "::" if ":" in (other.host or "") else "0.0.0.0"  # noqa: S104 - compared only
        return self.host in ("*", every)


class BackendKind(msgspec.Struct, frozen=True):
    """A kind of robot that a plugin can front; offered by the hook `rcp_backends`.

    `open(config, host)` is an async context manager that yields the `Backend`. Entering it
    connects; it declares resources through the host at any time. Inside it `NotReady` means try
    again with backoff, `ConfigError` stop for good.
    """

    name: str
    """Its name in the configuration: `use = "<name>"`."""
    config: type[msgspec.Struct]
    """Type of the plugin's table; decoded strictly by the kernel before `open` is called."""
    open: Callable[[Any, Host], AbstractAsyncContextManager[Backend]]
    description: str = ""
    """One line for `rcpd plugins`."""
    needs: tuple[str, ...] = ()
    """Modules of an extra that it cannot be opened without; where one is not installed, the
    gateway says which extra to install and continues without it."""
    check: Callable[[Any], None] | None = None
    """Raises `ConfigError` for faults of the table that its type cannot express; also called by
    `rcpd check`, so it opens nothing. What the machine lacks is for `lacks`: a gateway with such a
    fault does not start, and serves no other robot either."""
    wants: tuple[str, ...] = ()
    """Modules of an extra without which it does less; `rcpd check` warns where one is not installed."""
    exclusive: Callable[[Any], Iterable[Exclusive]] | None = None
    """Returns what no other backend can have open, such as ports; `rcpd check` refuses two of one."""
    remedy: str | None = None
    """What to do where one of `needs` is not installed; None: install the extra."""
    lacks: Callable[[Any], str | None] | None = None
    """Returns what this machine lacks for a table, such as a file or a library that only some tables
    need, and what to do; None: nothing. Called in a thread before each `open`: the backend is `down`
    for that reason until nothing is lacking. `rcpd check` calls it a fault."""
