"""Entries of the tree, the backends behind them, and their stop groups.

They reference one another: an entry its backend and its stop group, both of these their entries.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal, Protocol

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
from rcp_kernel.tree.samples import Form, Sample, form_of, forms
from rcp_kernel.values import ValueType, value_type

__all__ = [
    "BEFORE",
    "Availability",
    "Entry",
    "Listener",
    "LostCommand",
    "Owner",
    "RobotUnit",
    "is_system",
]

Availability = Literal["starting", "ready", "degraded", "down"]
_BY_SEVERITY = ("ready", "degraded", "starting", "down")
_IDLE_HISTORY = 16  # samples stored of a resource without subscribers
_HISTORY_BYTES = 4 * 1024 * 1024  # kept of one resource, at least its latest sample


def is_system(path: str) -> bool:
    """Return whether a path is in the gateway's own branch."""
    return path.startswith("/system/")


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
        """The stop groups of the backend."""
        ...

    def unit(self, robot: str | None) -> RobotUnit:
        """Return a stop group: one of its robots, or all of them."""
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


class Listener(Protocol):
    """A receiver of an entry's samples."""

    def offer(self, sample: Sample) -> None:
        """Handle a new sample; must neither block nor raise."""
        ...


class RemoteListener(Protocol):
    """A receiver of values in another frame, which the robot's own gateway sends."""

    def follow(self) -> None:
        """Receive them with the current rights and backend."""
        ...


class Entry:
    """A resource in its place in the tree."""

    __slots__ = (
        "_heard",
        "_monotonic",
        "_now",
        "barred",
        "clock",
        "deadline",
        "feedback_type",
        "framed",
        "input_type",
        "is_hold",
        "keeps_history",
        "kind",
        "label",
        "latest",
        "listeners",
        "live",
        "moves",
        "name",
        "numbered",
        "operations",
        "output_type",
        "owner",
        "parallel",
        "path",
        "resource",
        "ring",
        "robot",
        "seq",
        "sustained",
        "takes_frame",
        "tenant",
        "unit",
        "value_type",
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
        self.path = path
        self.name = resource.name
        self.resource = resource
        self.owner = owner
        self.unit = owner.unit(resource.robot)
        """The stop group it belongs to."""
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
        self.value_type: ValueType = value_type(resource.value)
        self.input_type: ValueType = value_type(resource.input)
        self.output_type: ValueType = value_type(resource.output)
        self.feedback_type: ValueType = value_type(resource.feedback)
        noun = "parameter" if self.kind is Kind.PARAM else self.kind.value
        self.label = f"{noun} '{resource.name.rpartition('/')[2]}'"
        self.latest: Sample | None = None
        self.seq = 0
        self.numbered = False
        """Whether its samples have the numbers of their source: `Encoded`."""
        self.ring: deque[Sample] = deque(maxlen=min(resource.history, _IDLE_HISTORY) or 1)
        self.keeps_history = False
        """Whether its whole history is stored even without subscribers."""
        self.listeners: list[Listener] = []
        self.framed: tuple[RemoteListener, ...] = ()
        """Receivers of values in other frames from the robot's own gateway."""
        self.sustained = 0.0
        """Rate in Hz at which it is published regardless of subscribers."""
        self.clock = clock
        self._now = clock.now
        self._monotonic = clock.monotonic
        self._heard = float("-inf")

    @property
    def age(self) -> float | None:
        """Seconds since the latest sample arrived; None if there has been none."""
        return None if self.latest is None else self._monotonic() - self._heard

    @property
    def stale(self) -> bool:
        """Whether the latest value is overdue for an update, or its robot is unavailable."""
        if self.latest is None or self.unit.usable_backend is None:
            return True
        return self.deadline is not None and self._monotonic() - self._heard > self.deadline

    def publish(self, value: Any, timestamp: int | None) -> Sample:
        """Create the next sample and offer it to every listener."""
        received = self._now()
        form: Form = "value"
        if type(value) is not self.value_type.type:  # the usual value has no other form
            kind: type = type(value)  # pyright: ignore[reportUnknownVariableType] - of any type
            form = forms.get(kind) or form_of(value)
        if form == "encoded":
            if self.latest is not None and value.seq <= self.seq:
                return self.latest
            self.numbered = True
            self.seq, timestamp = value.seq, value.timestamp
        elif self.numbered:  # its source is to publish it, with a number
            self.latest = Sample(self, value, timestamp or received, received, self.seq, form)
            return self.latest
        else:
            self.seq += 1
        sample = Sample(self, value, timestamp or received, received, self.seq, form)
        latest = self.latest
        if latest is not None:
            latest.release()
        self.latest = sample
        self._heard = self._monotonic()
        self.ring.append(sample)
        self.owner.samples += 1
        for listener in self.listeners:
            listener.offer(sample)
        if self.seq & 63 == 1:
            self.size_ring()
        return sample

    def keep_history(self) -> None:
        """Store the whole history even without subscribers."""
        self.keeps_history = True
        self.size_ring()

    def size_ring(self) -> None:
        """Store as many samples as history and memory allow, fewer without subscribers."""
        length = self.resource.history
        if not (self.listeners or self.keeps_history):
            length = min(length, _IDLE_HISTORY)
        if self.latest is not None and self.value_type.grows:
            try:
                length = min(length, _HISTORY_BYTES // max(1, self.latest.memory_size()))
            except RcpError:
                length = 1
        length = max(1, length)
        if length != self.ring.maxlen:
            self.ring = deque(self.ring, maxlen=length)

    def adopt(self, old: Entry) -> None:
        """Continue an earlier entry of the same path: its number, samples and listeners."""
        self.seq, self.numbered = old.seq, old.numbered
        self.keeps_history = old.keeps_history
        self.listeners, self.framed = old.listeners, old.framed
        self.sustained = old.sustained
        if old.resource.value == self.resource.value:
            self.latest, self.ring, self._heard = old.latest, old.ring, old._heard


BEFORE = -1
"""Number of stops before a command of an earlier gateway began."""


@dataclass(frozen=True, eq=False, slots=True)
class LostCommand:
    """A command that was lost with the link, or with an earlier gateway: the robot may still obey it."""

    path: str
    began: int
    """Number of stops before it began."""


class RobotUnit:
    """What an e-stop stops as a whole: all robots of a backend, or one that it can halt alone."""

    __slots__ = (
        "_halted",
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
        "lost",
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
        self.lost: LostCommand | None = None
        """The latest lost command; its loss policy has not been applied yet."""
        self._halted = BEFORE
        """Number of stops before the newest halt that has reached it."""
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

    def note_lost(self, path: str, began: int) -> bool:
        """Record that a command was lost which began after so many stops.

        Return False, and do nothing, if a halt has reached the robot since.
        """
        if began < self._halted:
            return False
        self.lost = LostCommand(path, began)
        return True

    def note_halted(self, number: int) -> None:
        """Record that a halt, sent after so many stops, has reached it: what began before is over."""
        self._halted = max(self._halted, number)
        if self.lost is not None and self.lost.began < self._halted:
            self.lost = None

    def note_reset(self) -> None:
        """Forget a lost command unless the robot is out of reach.

        Whoever resets an e-stop sees the robot and takes over, and a reset must not start a motion
        (ISO 13850, 4.1.4): the policy may be to land, or to return home. A robot that is out of reach
        has no operator until its link is restored.
        """
        if self.usable_backend is not None:
            self.lost = None

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
