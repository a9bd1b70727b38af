"""The links as status shows them: one row for each end that this process speaks to."""

from __future__ import annotations

from typing import Any

from rcp_zenoh.pipe import Pipe

__all__ = ["LinkStatistics", "Statistics"]


class LinkStatistics:
    """What all consecutive links with one other end have carried."""

    def __init__(self, row: dict[str, Any]) -> None:
        self._row = row
        self._sent = self._received = 0
        row |= {"links": 0, "lost": 0, "sent": 0, "received": 0}

    def opened(self) -> None:
        """Count a link."""
        self._row["links"] += 1

    def note(self, pipe: Pipe) -> None:
        """Take up the state of the current link."""
        row, times = self._row, pipe.times
        row["sent"] = self._sent + pipe.written
        row["received"] = self._received + pipe.received
        if times.latency is not None:
            row["latency"] = round(times.latency, 6)
        if times.offset is not None:
            row["clock_offset"], row["clock_bound"] = (round(one, 6) for one in times.offset)

    def ended(self, pipe: Pipe, why: str) -> None:
        """Count what a link has carried, and why it ended."""
        self._sent += pipe.written
        self._received += pipe.received
        self._row |= {"sent": self._sent, "received": self._received, "last_end": why}
        self._row["lost"] += pipe.lost


class Statistics:
    """The rows by hub."""

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []
        """What status shows; changed in place."""
        self._hubs: dict[str, LinkStatistics] = {}

    def of(self, hub: str) -> LinkStatistics:
        """Return the statistics of the links with a hub."""
        if hub not in self._hubs:
            row: dict[str, Any] = {"hub": hub}
            self.rows.append(row)
            self._hubs[hub] = LinkStatistics(row)
        return self._hubs[hub]
