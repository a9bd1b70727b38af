"""The links as status shows them: one row for each end that this process speaks to."""

from __future__ import annotations

from typing import Any

from rcp_zenoh.pipe import Pipe

__all__ = ["LinkStatistics", "Statistics"]

_MOST = 1024  # hubs without a link that are remembered: anybody can make up names


class LinkStatistics:
    """What all links with one other end have carried; several may be open at once."""

    def __init__(self, row: dict[str, Any]) -> None:
        self.row = row
        """What status shows; changed in place."""
        self._open: dict[Pipe, tuple[int, int]] = {}
        """What the row already has of each."""
        self._heard: float | None = None
        """Of links that have ended."""
        row |= {"links": 0, "lost": 0, "sent": 0, "received": 0}

    @property
    def idle(self) -> bool:
        """Whether no link is open."""
        return not self._open

    @property
    def heard(self) -> float | None:
        """When something was last received, by the clock of the event loop."""
        moments = (self._heard, *(pipe.heard for pipe in self._open))
        return max((one for one in moments if one is not None), default=None)

    def opened(self, pipe: Pipe) -> None:
        """Count a link."""
        self._open[pipe] = (0, 0)
        self.row["links"] += 1

    def count(self) -> None:
        """Take up what all open links have carried."""
        for pipe in self._open:
            self._count(pipe)

    def _count(self, pipe: Pipe) -> None:
        sent, received = self._open[pipe]
        self._open[pipe] = carried = (pipe.written, pipe.received)
        self.row["sent"] += carried[0] - sent
        self.row["received"] += carried[1] - received

    def note(self, pipe: Pipe) -> None:
        """Take up the state of an open link."""
        row, times = self.row, pipe.times
        self._count(pipe)
        if times.latency is not None:
            row["latency"] = round(times.latency, 6)
        if times.offset is not None:
            row["clock_offset"], row["clock_bound"] = (round(one, 6) for one in times.offset)

    def ended(self, pipe: Pipe, why: str) -> None:
        """Count what a link has carried, and why it ended."""
        self._heard = self.heard
        self._count(pipe)
        del self._open[pipe]
        self.row["last_end"] = why
        self.row["lost"] += pipe.lost


class Statistics:
    """The rows by hub."""

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []
        """What status shows; changed in place."""
        self._hubs: dict[str, LinkStatistics] = {}

    def of(self, hub: str) -> LinkStatistics:
        """Return the statistics of the links with a hub."""
        if hub not in self._hubs:
            if len(self._hubs) >= _MOST:
                self._forget()
            row: dict[str, Any] = {"hub": hub}
            self.rows.append(row)
            self._hubs[hub] = LinkStatistics(row)
        return self._hubs[hub]

    def _forget(self) -> None:
        """Forget the oldest hub that has no link."""
        gone = next((hub for hub, known in self._hubs.items() if known.idle), None)
        if gone is not None:
            self.rows.remove(self._hubs.pop(gone).row)
