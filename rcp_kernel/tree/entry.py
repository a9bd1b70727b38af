"""The tree's three parts: `Entry` (a resource), `RobotUnit` (what a stop stops), `Owner` (a backend).

They are one module because they reference one another: an entry its owner and its unit, both of
these their entries. `BackendSupervisor` is the `Owner` of all entries but those of `/system/`. What is
published on an entry is in `SampledResource`, its base.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from typing import Literal, Protocol

from rcp_kernel.clock import Clock, now
from rcp_kernel.errors import AdapterUnavailable, RcpError
from rcp_kernel.model import BRANCHES, MOVING, Kind, Operation, Resource, kind_of
from rcp_kernel.spi import (
    Anchor,
    Backend,
    FrameTree,
    MotionState,
    OwnLeases,
    RobotFacts,
    RobotLease,
    RobotLeaseRequest,
)
from rcp_kernel.tree.latches import Latch, Latches, robot_key, tenant_key
from rcp_kernel.tree.lost_command import LossRecord
from rcp_kernel.tree.sampled_resource import SampledResource
from rcp_kernel.values import ValueType, value_type

__all__ = [
    "Availability",
    "Entry",
    "Owner",
    "RobotUnit",
]

Availability = Literal["starting", "ready", "degraded", "down"]
_BY_SEVERITY = ("ready", "degraded", "starting", "down")


class Owner(Protocol):
    """The backend behind an entry, as the supervisor keeps it."""

    samples: int
    latency: float | None
    has_gateways: bool
    """Whether each of its robots has a gateway of its own: see `Backend.has_gateways`."""
    entries: dict[str, Entry]
    """Its resources, by the backend's own names."""

    @property
    def name(self) -> str:
        """The backend's name in the configuration."""
        ...

    @property
    def tenant(self) -> str | None:
        """The robot's tenant; None for the gateway's own branch."""
        ...

    @property
    def robot(self) -> str | None:
        """The segment after the branch in all its paths; None without one."""
        ...

    @property
    def on_loss(self) -> str:
        """The policy for a robot whose command was lost with its link: see `Backend.on_loss`."""
        ...

    @property
    def availability(self) -> Availability:
        """Whether the backend can be used."""
        ...

    @property
    def units(self) -> list[RobotUnit]:
        """The robot units of the backend."""
        ...

    def unit(self, robot: str | None) -> RobotUnit:
        """Return a robot unit: one of its robots, or all of them."""
        ...

    @property
    def backend(self) -> Backend | None:
        """The open backend, or None while it is not ready."""
        ...

    @property
    def closes(self) -> bool:
        """Whether it is closed, or being closed, for good."""
        ...

    def unavailable(self) -> RcpError:
        """Return the error that says why there is no backend now."""
        ...

    def fault(self, detail: str) -> None:
        """Record a fault of the backend."""
        ...

    def state_changed(self) -> None:
        """Announce that the state of one of its robots may have changed."""
        ...


class Entry(SampledResource["Owner"]):
    """A resource in its place in the tree: who may do what with it, and whose it is."""

    __slots__ = (
        "barred",
        "deadline",
        "feedback_type",
        "input_type",
        "is_hold",
        "kind",
        "label",
        "live",
        "moves",
        "name",
        "operations",
        "output_type",
        "parallel",
        "robot",
        "takes_frame",
        "tenant",
        "unit",
    )

    def __init__(
        self,
        path: str,
        resource: Resource,
        owner: Owner,
        tenant: str | None,
        robot: str | None,
        clock: Clock,
    ) -> None:
        super().__init__(path, resource, owner, clock)
        self.name = resource.name
        self.unit = owner.unit(resource.robot)
        """The robot unit it belongs to."""
        self.tenant = tenant
        self.robot = robot
        self.kind: Kind = kind_of(resource.name)
        offered = BRANCHES[self.kind] if resource.operations is None else resource.operations
        self.operations: Operation = offered
        self.moves = self.kind in MOVING if resource.moves is None else resource.moves
        """Whether it may move something."""
        self.barred = self.moves or resource.energises
        """Whether a latched e-stop refuses it."""
        policy = resource.policy
        self.parallel = policy == "parallel" or (policy is None and self.kind is Kind.SERVICE)
        """Whether commands run concurrently: the default of services."""
        self.takes_frame: bool | None = None
        """Whether its input is a goal in a frame that clients name; None: not determined yet."""
        self.is_hold = False
        """Whether it is the gateway's own hold service, which brings the robot to rest without an e-stop."""
        self.live = resource.live
        self.deadline = resource.deadline
        self.input_type: ValueType = value_type(resource.input)
        self.output_type: ValueType = value_type(resource.output)
        self.feedback_type: ValueType = value_type(resource.feedback)
        noun = "parameter" if self.kind is Kind.PARAM else self.kind.value
        self.label = f"{noun} '{resource.name.rpartition('/')[2]}'"

    @property
    def stale(self) -> bool:
        """Whether the latest value is overdue for an update, or its robot is unavailable."""
        if self.latest is None or self.unit.usable_backend is None:
            return True
        return self.deadline is not None and self._monotonic() - self._heard > self.deadline


class RobotUnit:
    """What an e-stop stops as a whole: all robots of a backend, or one that it can halt alone."""

    __slots__ = (
        "_latches",
        "_released",
        "_stopped",
        "_stops",
        "all_latches",
        "anchor",
        "detail",
        "facts",
        "frames",
        "holds",
        "identity",
        "keys",
        "loss",
        "name",
        "own",
        "own_leases",
        "owner",
        "retired",
        "robot",
        "since",
        "state",
        "usable_backend",
        "whole",
    )

    def __init__(self, owner: Owner, latches: Latches | None, robot: str | None = None) -> None:
        self.owner = owner
        self.robot = robot
        """The one robot's name in the tree; None means all of the backend."""
        self.whole: RobotUnit = self if robot is None else owner.unit(None)
        self.name = owner.name if robot is None else f"{owner.name}/{robot}"
        """Its name in errors and in the status; also one of its latches' keys, see `keys`."""
        tenant = "" if owner.tenant is None else tenant_key(owner.tenant)
        self.identity = "" if owner.tenant is None else robot_key(owner.tenant, self._segments())
        """The robot that it is, or is a part of: backends whose resources lie at the same place in
        the tree front one robot, and share this key of its latch."""
        own = (self.name,) if robot is None else (self.name, owner.name)
        self.keys = (*own, self.identity, tenant)
        """The keys of all latches that hold it but the gateway's, the narrowest first."""
        self.loss = LossRecord()
        """The command that it has lost with its link, if any."""
        self.usable_backend: Backend | None = None
        """The open backend, or None while there is none or this robot is down; set by the owner, as
        every request looks at it. Stops are sent regardless, by `backend`."""
        self.state: Availability = "ready"
        """What its backend reports about it alone."""
        self.detail: str | None = None
        """Why it is not ready."""
        self.since = now()
        """When that changed, ns."""
        self.facts = RobotFacts()
        """What its backend reports about it."""
        self.anchor: Anchor | None = None
        """Where one of its frames is fixed to the earth."""
        self.frames: FrameTree | None = None
        """The transforms between its frames, if its backend receives them."""
        self.own_leases: OwnLeases | None = None
        """The leases on it, as its own gateway reports them; None if it has none, or is not connected."""
        self.retired: Latch | None = None
        """A latch that is never reset: the backend was removed from the configuration."""
        self._latches = latches
        self.all_latches: Mapping[str, Latch] = {} if latches is None else latches.by_key
        """All latches of the gateway, also of other robots. Fast path: if empty and `retired` is None,
        skip the lookup of `latch`."""
        self.own: dict[str, Entry] = {}
        """The resources that are its own: of all of a backend, those of none of its robots."""
        self._stops = 0
        self._stopped = float("-inf")
        self._released = 0
        self.holds = 0
        """Number of holds that are bringing it to rest; see `is_held`, and `whole`."""

    @property
    def robot_segment(self) -> str | None:
        """The segment after the branch in all of its paths; None without one."""
        return self.owner.robot or self.robot

    def _segments(self) -> str:
        return "/".join(filter(None, (self.owner.robot, self.robot)))

    @property
    def tenant(self) -> str | None:
        """Its tenant."""
        return self.owner.tenant

    @property
    def latch(self) -> Latch | None:
        """The e-stop that holds it, or None."""
        latches, retired = self._latches, self.whole.retired
        if latches is None or (retired is None and not latches.by_key):
            return None
        return retired or latches.of(self.keys)

    @property
    def stops(self) -> int:
        """Number of e-stops and of stops by the guard process; requests admitted before one never reach it."""
        return self._stops if self.robot is None else self._stops + self.whole.stops

    @property
    def stopped(self) -> float:
        """When the last of its `stops` was, by `time.monotonic`; -inf if none was in this run."""
        return self._stopped if self.robot is None else max(self._stopped, self.whole.stopped)

    def note_reset(self) -> None:
        """Forget a lost command unless the robot is out of reach.

        Whoever resets an e-stop sees the robot and takes over, and a reset must not start a motion
        (ISO 13850, 4.1.4): the policy may be to land, or to return home. A robot that is out of reach
        has no operator until its link is restored.
        """
        if self.usable_backend is not None:
            self.loss.command = None

    @property
    def released(self) -> int:
        """When the last e-stop on it was reset, ns; 0 if none was in this run."""
        return self._released if self.robot is None else max(self._released, self.whole.released)

    @property
    def entries(self) -> dict[str, Entry]:
        """The resources that stop with it, by the backend's own names."""
        return self.owner.entries if self.robot is None else self.own

    @property
    def backend(self) -> Backend | None:
        """The open backend, or None."""
        return self.owner.backend

    @property
    def availability(self) -> Availability:
        """The availability of its backend, or its own if that is worse."""
        whole, own = self.owner.availability, self.state
        return own if _BY_SEVERITY.index(own) > _BY_SEVERITY.index(whole) else whole

    def unavailable(self) -> RcpError:
        """Return the error that says why it cannot be used now."""
        if self.owner.backend is None or self.state != "down":
            return self.owner.unavailable()
        why = f": {self.detail}" if self.detail else ""
        return AdapterUnavailable(
            f"robot '{self.robot}' is not connected (down){why}",
            origin=self.name,
            retry_after=1.0,
        )

    def count_stop(self) -> None:
        """Count a stop: nothing that was admitted before reaches it."""
        self._stops += 1
        self._stopped = time.monotonic()

    @property
    def is_held(self) -> bool:
        """Whether it is being brought to rest without an e-stop."""
        return self.holds > 0 or self.whole.holds > 0

    @contextmanager
    def bringing_to_rest(self) -> Generator[None]:
        """Refuse other commands while entered: they would override the hold."""
        self.holds += 1
        try:
            self.owner.state_changed()
            yield
        finally:
            self.holds -= 1
            self.owner.state_changed()

    def release(self, moment: int) -> None:
        """Record a reset: nothing that was sent before `moment` (ns) reaches it."""
        self._released = moment

    async def halt(self) -> None:
        """Bring it to rest; return when it is measured to be, as far as the backend measures.

        :raises AdapterUnavailable: there is no backend, or it cannot reach the robot.
        """
        backend = self._open()
        await (backend.halt() if self.robot is None else backend.halt_robot(self.robot))

    async def reset_own(self) -> None:
        """Ask its own gateway to reset its e-stop: see `Backend.reset_estop`.

        :raises RcpError: it refuses, or cannot be reached.
        """
        await self._open().reset_estop(self.robot)

    async def lease_own(self, request: RobotLeaseRequest) -> RobotLease:
        """Ask its own gateway for a lease: see `Backend.lease`.

        :raises RcpError: it refuses, or cannot be reached.
        """
        assert self.robot is not None
        return await self._open().lease(self.robot, request)

    async def hold(self) -> None:
        """Bring it to rest without an e-stop.

        :raises AdapterUnavailable: as `halt` does.
        """
        await self._open().hold(self.robot)

    def motion(self) -> MotionState | None:
        """Return the measured state of motion; None if there is no measurement.

        :raises AdapterUnavailable: there is no backend.
        """
        return self._open().motion(self.robot)

    def _open(self) -> Backend:
        backend = self.backend
        if backend is None:
            raise self.owner.unavailable()
        return backend
