"""The guard: whoever holds no lease on a path does not command it while somebody else does."""

from __future__ import annotations

from rcp_kernel.features import Call, Slot
from rcp_leases.leases import Leases

__all__ = ["LeaseGuard"]


class LeaseGuard:
    """Asks the leases when a command comes in, and again when it acts."""

    slot = Slot.LEASE
    active = True
    """Anybody may acquire a lease at any time."""

    def __init__(self, leases: Leases) -> None:
        self._leases = leases

    def admit(self, call: Call) -> None:
        """Refuse what somebody else's lease, or a lost or missing one, forbids.

        :raises LeaseHeld, LeaseLost, LeaseRequired: as `Leases.check` does.
        """
        if self._leases.in_use:
            self._leases.check(call.session, call.entry)

    def confirm(self, call: Call) -> None:
        """Refuse it as `admit` does: a lease may have come or gone meanwhile."""
        if self._leases.in_use:
            self._leases.check(call.session, call.entry)
