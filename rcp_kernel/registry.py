"""The context registry: every path with its resource, types, latest sample and backend.

Lookups are one dictionary access. Whatever searches (patterns, discovery) works on a sorted index
that is rebuilt when the tree changes, never for a request.
"""

from __future__ import annotations

import re
import time
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Protocol

from rcp_kernel.clock import now
from rcp_kernel.errors import PluginError, RcpError
from rcp_kernel.model import (
    BRANCHES,
    MOVING,
    Kind,
    Operation,
    Pattern,
    Resource,
    full_path,
    kind_of,
)
from rcp_kernel.spi import Backend
from rcp_kernel.streaming.samples import Sample
from rcp_kernel.values import ValueType, value_type

if TYPE_CHECKING:
    from rcp_kernel.motion.stop_group import StopGroup

__all__ = ["Entry", "Listener", "Owner", "Registry"]

_IDLE_HISTORY = 16  # samples kept of a resource nobody subscribes to
_WITHDRAWN = 10_000  # paths whose number is remembered
_ROBOT = 4  # the part of a full path that names the robot, where a backend has one
_HISTORY_BYTES = 4 * 1024 * 1024  # kept of one resource, at least its latest sample


class Owner(Protocol):
    """The backend behind an entry, as the supervisor keeps it."""

    samples: int
    latency: float | None
    entries: dict[str, Entry]
    """Its resources, by the backend's own names."""

    @property
    def name(self) -> str:
        """The backend's name in the configuration."""
        ...

    @property
    def tenant(self) -> str | None:
        """Whose robot it is; None for the gateway's own branch."""
        ...

    @property
    def robot(self) -> str | None:
        """The segment after the branch in all its paths; None without one."""
        ...

    @property
    def on_loss(self) -> str:
        """What becomes of a robot whose command was lost with its link: see `Backend.on_loss`."""
        ...

    @property
    def units(self) -> list[StopGroup]:
        """What an e-stop can stop alone, each."""
        ...

    def unit(self, robot: str | None) -> StopGroup:
        """Return what an e-stop stops: one of its robots, or all of them."""
        ...

    @property
    def backend(self) -> Backend | None:
        """The open backend, or None while it is not ready."""
        ...

    def unavailable(self) -> RcpError:
        """Return the error that says why there is no backend now."""
        ...

    def fault(self, detail: str) -> None:
        """Note a fault of the backend's own making."""
        ...


class Listener(Protocol):
    """Somebody to whom an entry's samples are offered."""

    def offer(self, sample: Sample) -> None:
        """Take notice of a new sample; must neither block nor raise."""
        ...


class Entry:
    """A resource in its place in the tree."""

    __slots__ = (
        "_heard",
        "barred",
        "deadline",
        "feedback_type",
        "input_type",
        "is_hold",
        "kind",
        "label",
        "latest",
        "listeners",
        "live",
        "moves",
        "name",
        "operations",
        "output_type",
        "owner",
        "path",
        "resource",
        "ring",
        "robot",
        "seq",
        "sustained",
        "tenant",
        "unit",
        "value_type",
        "written",
    )

    def __init__(
        self, path: str, resource: Resource, owner: Owner, tenant: str | None, robot: str | None
    ) -> None:
        self.path = path
        self.name = resource.name
        self.resource = resource
        self.owner = owner
        self.unit = owner.unit(resource.robot)
        """What an e-stop stops together with it."""
        self.tenant = tenant
        self.robot = robot
        self.kind: Kind = kind_of(resource.name)
        offered = BRANCHES[self.kind] if resource.operations is None else resource.operations
        self.operations: Operation = offered
        self.moves = self.kind in MOVING if resource.moves is None else resource.moves
        """Whether it may move something."""
        self.barred = self.moves or resource.energises
        """Whether a latched e-stop refuses it."""
        self.is_hold = False
        """Whether it is the gateway's own verb that brings the robot to rest without an e-stop."""
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
        self.ring: deque[Sample] = deque(maxlen=min(resource.history, _IDLE_HISTORY) or 1)
        self.listeners: list[Listener] = []
        self.sustained = 0.0
        """Rate in Hz at which it is published whoever listens."""
        self.written: float | None = None
        """Monotonic time of the last write, for rates of change and the dead-man."""
        self._heard = 0.0

    @property
    def age(self) -> float | None:
        """Seconds since the latest sample came in, or None if none ever did."""
        return None if self.latest is None else time.monotonic() - self._heard

    @property
    def stale(self) -> bool:
        """Whether the latest value has a successor overdue, or its backend is gone."""
        if self.latest is None or self.owner.backend is None:
            return True
        return self.deadline is not None and time.monotonic() - self._heard > self.deadline

    def publish(self, value: Any, timestamp: int | None) -> Sample:
        """Make the next sample and offer it to every listener."""
        received = now()
        self.seq += 1
        sample = Sample(self, value, timestamp or received, received, self.seq)
        if self.latest is not None:
            self.latest.forget_encodings()
        self.latest = sample
        self._heard = time.monotonic()
        self.ring.append(sample)
        self.owner.samples += 1
        for listener in self.listeners:
            listener.offer(sample)
        if self.seq & 63 == 1:
            self.size_ring()
        return sample

    def size_ring(self) -> None:
        """Keep as many samples as history and memory allow, fewer while nobody listens."""
        wanted = self.resource.history if self.listeners else _IDLE_HISTORY
        wanted = min(wanted, self.resource.history)
        if self.latest is not None and self.value_type.grows:
            try:
                wanted = min(wanted, _HISTORY_BYTES // max(1, self.latest.weight()))
            except RcpError:
                wanted = 1
        wanted = max(1, wanted)
        if wanted != self.ring.maxlen:
            self.ring = deque(self.ring, maxlen=wanted)

    def adopt(self, old: Entry) -> None:
        """Go on where an entry of the same path left off: number, samples and listeners."""
        self.seq = old.seq
        self.listeners = old.listeners
        self.sustained = old.sustained
        self.written = old.written
        if old.resource.value == self.resource.value:
            self.latest, self.ring, self._heard = old.latest, old.ring, old._heard


class Registry:
    """The tree. Only the event loop's thread touches it."""

    def __init__(self) -> None:
        self.entries: dict[str, Entry] = {}
        self.generation = 0
        """Rises with every change of the tree: the validator of caches and ETags."""
        self.on_added: list[Callable[[Entry], None]] = []
        self.on_removed: list[Callable[[Entry], None]] = []
        self._growing: list[Owner] = []
        """Backends that have not declared all that they may have."""
        self._index: list[str] | None = None
        self._numbers: dict[str, int] = {}
        """Last sample number of withdrawn paths, so that a path that returns counts on."""

    def declare(
        self, owner: Owner, resource: Resource, *, tenant: str, robot: str | None = None
    ) -> Entry:
        """Put a backend's resource into the tree, or replace it.

        :raises PluginError: the path belongs to another backend, a type has no schema, or an
            example does not fit its type.
        """
        path = full_path(tenant, robot, resource.name)
        return self.place(Entry(path, _checked(resource), owner, tenant, robot))

    def place(self, entry: Entry) -> Entry:
        """Put an entry into the tree.

        :raises PluginError: its path belongs to another backend.
        """
        old = self.entries.get(entry.path)
        if old is not None:
            if old.owner is not entry.owner:
                raise PluginError(
                    f"{entry.path} is declared by backend '{old.owner.name}' and by "
                    f"'{entry.owner.name}': set a different `robot` for one of them"
                )
            if old.resource == entry.resource:
                return old
            entry.adopt(old)
        else:
            entry.seq = self._numbers.pop(entry.path, 0)
        self.entries[entry.path] = entry
        self._changed()
        for told in self.on_added:
            told(entry)
        return entry

    def withdraw(self, path: str) -> None:
        """Take an entry out of the tree; an unknown path is ignored."""
        entry = self.entries.pop(path, None)
        if entry is None:
            return
        self._numbers[path] = entry.seq
        while len(self._numbers) > _WITHDRAWN:
            del self._numbers[next(iter(self._numbers))]
        self._changed()
        for told in self.on_removed:
            told(entry)

    def grow(self, owner: Owner, *, growing: bool) -> None:
        """Note whether a backend may still declare what it has not: it opens, or looks for more."""
        if growing == (owner in self._growing):
            return
        if growing:
            self._growing.append(owner)
        else:
            self._growing.remove(owner)
        self.generation += 1

    def may_come(self, path: str) -> bool:
        """Tell whether a path that is not in the tree may yet be declared, by its place there."""
        return bool(self._growing) and any(_may_own(owner, path) for owner in self._growing)

    def growing(self, pattern: Pattern) -> set[str]:
        """Return the tenants in which a pattern may reach more when all backends are open."""
        if pattern.literal:
            owners = [o for o in self._growing if _may_own(o, pattern.text)]
        else:
            owners = [o for o in self._growing if _meet(pattern.prefix, f"/tenant/{o.tenant}")]
        return {owner.tenant for owner in owners if owner.tenant is not None}

    def _changed(self) -> None:
        self.generation += 1
        self._index = None

    @property
    def index(self) -> list[str]:
        """Every path, sorted."""
        if self._index is None:
            self._index = sorted(self.entries)
        return self._index

    def match(self, pattern: Pattern, after: str = "") -> Iterator[Entry]:
        """Find the entries that a pattern stands for, in order of path, from behind `after` on."""
        if pattern.literal:
            entry = self.entries.get(pattern.text)
            if entry is not None and entry.path > after:
                yield entry
            return
        index = self.index
        start = max(bisect_left(index, pattern.prefix), bisect_right(index, after))
        for path in index[start:]:
            if not path.startswith(pattern.prefix):
                break
            # Whoever goes through them in steps may find some gone.
            if pattern.matches(path) and (entry := self.entries.get(path)) is not None:
                yield entry


def _may_own(owner: Owner, path: str) -> bool:
    parts = path.split("/")  # "", "tenant", its name, the branch, and the robot or a name
    if parts[1] != "tenant" or len(parts) <= _ROBOT or parts[2] != owner.tenant:
        return False
    return owner.robot is None or (parts[_ROBOT] == owner.robot and len(parts) > _ROBOT + 1)


def _meet(prefix: str, place: str) -> bool:
    """Tell whether one of two runs of segments begins the other."""
    return f"{prefix}/".startswith(f"{place}/") or f"{place}/".startswith(f"{prefix}/")


_SENTENCE = re.compile(r"\S.*\.\Z", re.DOTALL)


def _checked(resource: Resource) -> Resource:
    kind = kind_of(resource.name)
    called = kind in (Kind.ACTION, Kind.SERVICE)
    if not called and resource.value is None:
        raise PluginError(f"resource '{resource.name}' declares no type for its `value`")
    if not _SENTENCE.match(resource.description):
        raise PluginError(
            f"the description of '{resource.name}' must be a sentence that ends in a full stop"
        )
    type_ = value_type(resource.input if called else resource.value)
    for example in resource.examples:
        try:
            type_.convert(example, f"example of '{resource.name}'")
        except RcpError as error:
            raise PluginError(error.message) from None
    if resource.valid_for is not None and resource.safe is None:
        raise PluginError(f"'{resource.name}' has `valid_for` and no `safe` value to fall back to")
    return resource
