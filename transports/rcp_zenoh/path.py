"""What the heartbeats of one link tell: how long it takes, and what time it is at the other end."""

from __future__ import annotations

import struct
import time
from collections import deque
from typing import NamedTuple

__all__ = ["Beat", "PathTimes"]

_FORM = struct.Struct("<?4Qdqdd")
_SAMPLES = 8  # the one with the least delay bounds the offset best


class Beat(NamedTuple):
    """The content of a heartbeat."""

    idle: bool
    """Nothing is unacknowledged: the next one comes later."""
    taken: tuple[int, ...]
    """Bytes received, by class."""
    sent: float
    """Monotonic time of the sender."""
    wall: int
    """Its time of day, ns."""
    echo: float
    """The last `sent` that it has received, 0 if none."""
    held: float
    """Seconds since it received that."""

    @classmethod
    def read(cls, data: bytes) -> Beat | None:
        """Decode a heartbeat; a later version may say more."""
        if len(data) < _FORM.size:
            return None
        idle, *taken, sent, wall, echo, held = _FORM.unpack_from(data)
        return cls(idle, tuple(taken), sent, wall, echo, held)

    def write(self) -> bytes:
        """Encode it."""
        return _FORM.pack(self.idle, *self.taken, self.sent, self.wall, self.echo, self.held)


class _Probe(NamedTuple):
    delay: float
    offset: float


class PathTimes:
    """The delay of one link, and the offset of the clock at its other end."""

    __slots__ = ("_echo", "_echo_at", "_probes")

    def __init__(self) -> None:
        self._echo, self._echo_at = 0.0, float("-inf")
        self._probes: deque[_Probe] = deque(maxlen=_SAMPLES)

    def beat(self, taken: tuple[int, ...], *, idle: bool) -> Beat:
        """Make a heartbeat to send."""
        moment = time.monotonic()
        held = moment - self._echo_at if self._echo else 0.0
        return Beat(idle, taken, moment, time.time_ns(), self._echo, held)

    def note(self, beat: Beat) -> None:
        """Take up a heartbeat of the other end."""
        moment = time.monotonic()
        self._echo, self._echo_at = beat.sent, moment
        if beat.echo:
            delay = max(0.0, moment - beat.echo - beat.held)
            offset = (beat.wall - time.time_ns()) / 1e9 + delay / 2
            self._probes.append(_Probe(delay, offset))

    @property
    def latency(self) -> float | None:
        """Seconds of the last round trip."""
        return self._probes[-1].delay if self._probes else None

    @property
    def offset(self) -> tuple[float, float] | None:
        """How far the other end's clock is ahead, and the bound of the error, in seconds."""
        if not self._probes:
            return None
        best = min(self._probes)
        return best.offset, best.delay / 2
