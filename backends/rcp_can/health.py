"""The health of the backend as one text, reported when it changes."""

from __future__ import annotations

from rcp_kernel.spi import Host

__all__ = ["Health"]


class Health:
    """Collects the problems of buses, motors and devices."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._complaints: dict[str, str] = {}
        self._reported: str | None = None

    def report(self, source: str, what: str | None) -> None:
        """Set the problem of a source, or clear it with None."""
        if what is None:
            self._complaints.pop(source, None)
        else:
            self._complaints[source] = what
        complaints = "; ".join(self._complaints.values()) or None
        if complaints != self._reported:
            self._reported = complaints
            self._host.report(complaints)
