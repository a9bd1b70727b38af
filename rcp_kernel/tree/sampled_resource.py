"""The samples of a resource: numbered, kept, and offered to whoever listens."""

from __future__ import annotations

from collections import deque
from typing import Any, Generic, Protocol, TypeVar

from rcp_kernel.clock import Clock
from rcp_kernel.errors import RcpError
from rcp_kernel.model import Resource
from rcp_kernel.tree.samples import Form, Listener, Publisher, Sample, form_of, forms
from rcp_kernel.values import ValueType, value_type

__all__ = ["RemoteListener", "SampledResource"]

_IDLE_HISTORY = 16  # samples stored of a resource without subscribers
_HISTORY_BYTES = 4 * 1024 * 1024  # kept of one resource, at least its latest sample


class CountedPublisher(Publisher, Protocol):
    """A backend whose samples are counted."""

    samples: int
    """Number of samples of all its resources."""


_Owner = TypeVar("_Owner", bound=CountedPublisher)


class RemoteListener(Protocol):
    """A receiver of values in another frame, which the robot's own gateway sends."""

    def follow(self) -> None:
        """Receive them with the current rights and backend."""
        ...


class SampledResource(Generic[_Owner]):
    """A resource as a source of samples: the base of `Entry`, so that a read needs one object only."""

    __slots__ = (
        "_heard",
        "_monotonic",
        "_now",
        "clock",
        "framed",
        "keeps_history",
        "latest",
        "listeners",
        "numbered",
        "owner",
        "path",
        "resource",
        "ring",
        "seq",
        "sustained",
        "value_type",
    )

    def __init__(self, path: str, resource: Resource, owner: _Owner, clock: Clock) -> None:
        self.path = path
        self.resource = resource
        self.owner = owner
        self.value_type: ValueType = value_type(resource.value)
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

    def adopt(self, old: SampledResource[_Owner]) -> None:
        """Continue an earlier resource of the same path: its number, samples and listeners."""
        self.seq, self.numbered = old.seq, old.numbered
        self.keeps_history = old.keeps_history
        self.listeners, self.framed = old.listeners, old.framed
        self.sustained = old.sustained
        if old.resource.value == self.resource.value:
            self.latest, self.ring, self._heard = old.latest, old.ring, old._heard
