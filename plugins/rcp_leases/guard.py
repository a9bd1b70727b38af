"""The guard: refuses commands to a path while another session holds a lease on it."""

from __future__ import annotations

from rcp_kernel.features import Call, Slot
from rcp_leases.leases import Leases

__all__ = ["LeaseGuard"]


class LeaseGuard:
    """Checks the leases when a command arrives, and again just before it acts."""

    slot = Slot.LEASE
    active = True
    """A lease may be acquired at any time."""

    def __init__(self, leases: Leases) -> None:
        self._leases = leases

    def admit(self, call: Call) -> None:
        """Check the leases of a path.

        :raises LeaseHeld, LeaseLost, LeaseRequired: see `Leases.check`.
        """
        if self._leases.in_use:
            self._leases.check(call.session, call.entry)

    def confirm(self, call: Call) -> None:
        """Repeat the check of `admit`: leases may have changed since."""
        if self._leases.in_use:
            self._leases.check(call.session, call.entry)
