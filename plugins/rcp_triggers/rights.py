"""Who may make triggers, and who sees what of them: as much as one may read of the robots."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rcp_conditions import Condition, Ref
from rcp_kernel.access.acl import Rights, reach
from rcp_kernel.access.visibility import names_in
from rcp_kernel.contract.identity import Principal
from rcp_kernel.errors import Forbidden, RcpError, UnknownPath
from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Operation
from rcp_kernel.sessions.session import Session
from rcp_triggers.place import Place
from rcp_triggers.spec import Do, command_for

__all__ = ["TRANSPORT", "TriggerRights"]

TRANSPORT = "triggers"
"""What sessions, records and metrics call the requests of triggers."""


class TriggerRights:
    """Judges by the tree as it is; `path` is that of the resource in question."""

    def __init__(self, host: FeatureHost, path: str) -> None:
        self._host = host
        self._path = path

    def paths(self, conditions: Iterable[Condition], place: Place) -> tuple[str, ...]:
        """Return the resources that conditions are about; of one that is missing, its likely path."""
        refs = dict.fromkeys(ref for one in conditions for ref in one.refs)
        return tuple(dict.fromkeys(self._path_of(ref, place) for ref in refs))

    def _path_of(self, ref: Ref, place: Place) -> str:
        found = self._host.robots.conditions.resource(ref, place)
        return place.path("/".join(ref[:2])) if found is None else found[0].path

    # -- seeing --------------------------------------------------------------------------------

    def in_tenant(self, rights: Rights, tenant: str, operation: Operation, path: str) -> bool:
        """Return whether a role that is held in a tenant allows an operation on a system path."""
        places = rights.places(path, operation)
        return "*" in places or tenant in places

    def sees(self, rights: Rights, tenant: str, paths: Iterable[str], facts: Any) -> bool:
        """Return whether somebody may read all of some resources, and see what `facts` mention."""
        return all(self._reads(rights, path) for path in paths) and not (
            self._host.visibility.mentions_hidden(rights, tenant, names_in(facts))
        )

    def _reads(self, rights: Rights, path: str) -> bool:
        entry = self._host.robots.entries.get(path)
        mask = reach(rights.compute_mask(path) if entry is None else rights.mask(path))
        if entry is None or not entry.operations & Operation.READ:
            return bool(mask)
        return bool(mask & int(Operation.READ))

    # -- making --------------------------------------------------------------------------------

    def check_reads(self, session: Session, conditions: Iterable[Condition], place: Place) -> None:
        """Refuse conditions about what a session may not read.

        :raises UnknownPath: a resource does not exist, or is hidden.
        :raises Forbidden: it may not be read.
        """
        for ref in dict.fromkeys(ref for one in conditions for ref in one.refs):
            found = self._host.robots.conditions.resource(ref, place)
            if found is None or not session.rights.mask(found[0].path):
                raise UnknownPath(
                    f"the condition refers to {'.'.join(ref)}, which is not a value of {place.key}",
                    remedy="Refer to a sensor, actuator, param or event of the robot, while it is "
                    "connected.",
                )
            path = found[0].path
            if not self._reads(session.rights, path):
                raise Forbidden(f"{session.principal.name} may not read {path}", path=path)

    def check_command(self, session: Session, do: Do, place: Place) -> None:
        """Refuse a command that a session may not send in any state of the robot.

        :raises UnknownPath: there is no such resource, or it is hidden.
        :raises Forbidden: it may not be executed.
        """
        path, _ = command_for(do, place)
        entry = self._host.robots.entries.get(path)
        if entry is None or not session.rights.mask(path):
            raise UnknownPath(f"{path} does not exist", path=path)
        if not reach(session.rights.mask(path)) & entry.operations & Operation.EXECUTE:
            raise Forbidden(f"{session.principal.name} may not execute {path}", path=path)

    def stopped(self, maker: Principal, tenant: str, paths: Iterable[str]) -> str | None:
        """Return why a trigger that somebody made must not run now; None if it may."""
        delegation = self._host.delegation
        principal = delegation.renewed(maker)
        if principal is None:
            return f"the credentials of {maker.name} are no longer valid"
        try:
            rights = delegation.session(principal, tenant, TRANSPORT).rights
        except RcpError as error:
            return error.message
        if not self.in_tenant(rights, tenant, Operation.EXECUTE, self._path):
            return f"{maker.name} may no longer use {self._path}"
        for path in paths:
            if not self._reads(rights, path):
                return f"{maker.name} may no longer read {path}"
        return None
