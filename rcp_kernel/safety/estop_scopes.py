"""Which robots and latches an e-stop means: its scope, by what a session may see."""

from __future__ import annotations

from collections.abc import Sequence

from rcp_kernel.access.acl import Rights
from rcp_kernel.access.identities import Identities
from rcp_kernel.access.scope_rights import ScopeRights
from rcp_kernel.config.settings import Settings
from rcp_kernel.errors import Forbidden, UnknownPath
from rcp_kernel.safety.stop import merged
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Owner, RobotUnit
from rcp_kernel.tree.latches import GATEWAY, tenant_key
from rcp_kernel.tree.scope import Scope

__all__ = ["EstopScopes", "latch_keys"]

_Robots = dict[RobotUnit, None]
"""A set in the order of the configuration."""


class EstopScopes:
    """Resolves the scopes of e-stops."""

    def __init__(
        self,
        supervisors: Sequence[Owner],
        rights: ScopeRights,
        identities: Identities,
        settings: Settings,
    ) -> None:
        self._supervisors = supervisors
        self._rights = rights
        self._identities = identities
        self._settings = settings

    def visible(self, session: Session) -> _Robots:
        """Return the robots that a session may see."""
        rights, sees = session.rights, self._rights.sees_robot
        return {
            unit: None
            for supervisor in self._supervisors
            for unit in supervisor.units
            if sees(rights, unit)
        }

    def groups_of(self, session: Session, visible: _Robots) -> tuple[str, ...]:
        """Return the groups of the configuration with a robot that is visible to a session."""
        return tuple(
            name for name in self._groups() if self._members(session.rights, name, visible)
        )

    def _groups(self) -> dict[str, tuple[str, ...]]:
        return self._settings.config.safety.groups

    def resolve(
        self, session: Session, scope: str | None
    ) -> tuple[dict[str, str | None], list[RobotUnit]]:
        """Return the keys of the latches that a scope means, with their tenants, and the robots.

        :raises UnknownPath: it contains no robot visible to the session.
        :raises Forbidden: the session may not stop the robots of several tenants at once.
        """
        tenants = self._identities.tenants_of(session.principal)
        visible, rights = self.visible(session), session.rights
        if scope is None and not session.rights.may_stop_all():
            scope = self._own_tenant(session)
        if scope is None:
            robots = list(visible)
            if "*" in rights.tenants and not self._hidden(visible, None):
                keys: dict[str, str | None] = {GATEWAY: None}
            else:
                keys = self._widest(visible, tenants, robots)
        elif scope in self._groups():
            robots = self._members(rights, scope, visible)
            keys = latch_keys(robots)
        elif not scope.startswith("/"):
            robots = [unit for unit in visible if scope in (unit.name, unit.whole.name)]
            keys = latch_keys(robots)
        else:
            found = Scope(scope, session.tenant)
            robots = self._in(rights, found, visible)
            if found.whole and found.tenant in tenants:
                keys = self._widest(visible, [found.tenant], robots)
            else:
                keys = latch_keys(robots)
        if not keys:
            raise UnknownPath(
                f"no robot in the scope {scope or 'of this session'!r}",
                remedy="/system/estop and /system/status list the robots and groups.",
            )
        return keys, self._with_partners(robots)

    def _own_tenant(self, session: Session) -> str:
        if session.tenant is None:
            raise Forbidden(
                f"{session.principal.name} may not stop robots of several tenants at once",
                remedy="Set `scope` to a tenant (/tenant/<tenant>), a robot, or a group.",
            )
        return tenant_key(session.tenant)

    def _members(self, rights: Rights, group: str, visible: _Robots) -> list[RobotUnit]:
        """List the robots of a group that are visible."""
        found: _Robots = {}
        for scope in self._groups()[group]:
            found |= dict.fromkeys(self._in(rights, Scope(scope), visible))
        return list(found)

    def _in(self, rights: Rights, scope: Scope, visible: _Robots) -> list[RobotUnit]:
        return [unit for unit in visible if self._within(rights, unit, scope)]

    def _with_partners(self, units: list[RobotUnit]) -> list[RobotUnit]:
        """Add the other backends of the same robots, regardless of visibility."""
        meant = {unit.identity for unit in units}
        partners = (
            unit
            for supervisor in self._supervisors
            for unit in supervisor.units
            if unit.identity in meant and unit.own
        )
        return list(dict.fromkeys((*units, *partners)))

    def _widest(
        self, visible: _Robots, tenants: list[str], robots: list[RobotUnit]
    ) -> dict[str, str | None]:
        """Return keys of whole tenants whose robots the session sees all, else of the robots it sees."""
        keys: dict[str, str | None] = {}
        for tenant in tenants:
            if not self._hidden(visible, tenant):
                keys[tenant_key(tenant)] = tenant
            else:
                keys |= latch_keys([unit for unit in robots if unit.tenant == tenant])
        return keys

    def _hidden(self, visible: _Robots, tenant: str | None) -> bool:
        """Return whether there is a robot that is not visible, or none at all."""
        units = [
            u
            for supervisor in self._supervisors
            for u in supervisor.units
            if tenant in (None, supervisor.tenant)
        ]
        return not units or any(unit.own and unit not in visible for unit in units)

    def _within(self, rights: Rights, unit: RobotUnit, scope: Scope) -> bool:
        if unit.tenant != scope.tenant:
            return False
        if scope.whole or (scope.robot is not None and scope.robot == unit.robot_segment):
            return True
        return self._rights.sees_robot(rights, unit, scope)


def latch_keys(units: list[RobotUnit]) -> dict[str, str | None]:
    """Return the keys of the latches for robots, those of whole backends where they can be."""
    names = {unit.name: unit.tenant for unit in merged(units)}
    return names | {unit.identity: unit.tenant for unit in units}
