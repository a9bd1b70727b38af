"""What is wrong with the backend as a whole: one sentence for all that is, told when it changes."""

from __future__ import annotations

from rcp_kernel.spi import Host

__all__ = ["Health"]


class Health:
    """Gathers what buses, motors and devices complain of."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._complaints: dict[str, str] = {}
        self._reported: str | None = None

    def report(self, source: str, what: str | None) -> None:
        """Complain, or with None be well again."""
        if what is None:
            self._complaints.pop(source, None)
        else:
            self._complaints[source] = what
        complaints = "; ".join(self._complaints.values()) or None
        if complaints != self._reported:
            self._reported = complaints
            self._host.report(complaints)
