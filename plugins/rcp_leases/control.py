"""Leases as the check of a plan sees them."""

from __future__ import annotations

from typing import Any

from rcp_kernel.features import Scope
from rcp_kernel.features.control import Holder
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_leases.leases import Leases
from rcp_leases.requests import PATH

__all__ = ["LeaseControl"]


class LeaseControl:
    """The `ControlService` and the `HolderService` of leases."""

    def __init__(self, leases: Leases) -> None:
        self._leases = leases
        self.check = leases.check

    def holder(self, entry: Entry) -> Holder | None:
        """Return the holder of the lease that a resource is under."""
        lease = self._leases.over(entry.path)
        if lease is not None:
            return Holder(lease.holder, lease.scope, lease.expires)
        there = self._leases.gateways.over(entry.unit, entry.path)
        return None if there is None else Holder(there.holder, Scope(there.scope), there.expires)

    def gains(self, session: Session, entry: Entry, value: Any) -> Scope | None:
        """Return the scope that a lease request would grant.

        :raises InvalidPath: it is not a valid scope.
        """
        if entry.path != PATH or not isinstance(value, dict) or value.get("do") != "acquire":
            return None
        scope = value.get("scope")
        return Scope(scope, session.tenant) if isinstance(scope, str) else None
