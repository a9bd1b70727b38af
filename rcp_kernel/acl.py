"""What a principal may do: roles of allow and deny rules, compiled to one bit mask for each path.

Deny wins, and nothing is allowed that no rule allows. Roles are given per tenant: a rule reaches
only into the tenant in which its role is held, whatever its pattern says, and into `/system/`. The mask of a path is worked out once for each set of
roles and kept until the tree or the rules change, so a request costs one dictionary access.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from rcp_kernel.identity import Grants, Principal
from rcp_kernel.model import Operation, Pattern, tenant_of

__all__ = ["BUILTIN_ROLES", "Rights", "Role", "Rule", "Rules"]

OperationName = Literal["discover", "read", "write", "execute", "subscribe", "*"]
_ALL = (
    Operation.READ | Operation.WRITE | Operation.EXECUTE | Operation.SUBSCRIBE | Operation.DISCOVER
)
_MAX_KNOWN = 200_000


class Rule(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Operations on the paths of some patterns."""

    operations: tuple[OperationName, ...]
    paths: tuple[str, ...]

    @property
    def mask(self) -> Operation:
        """The operations as bits; whatever may be done may be discovered too."""
        bits = Operation.NONE
        for name in self.operations:
            bits |= _ALL if name == "*" else Operation[name.upper()]
        return bits


class Role(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A named set of rules."""

    allow: tuple[Rule, ...] = ()
    deny: tuple[Rule, ...] = ()
    reset: bool = False
    """May reset a latched e-stop."""
    priority: Annotated[int, Meta(ge=0, le=100)] = 50
    """Who takes a lease from whom: a person (50) beats an agent (10)."""


_LOOK: tuple[OperationName, ...] = ("discover", "read", "subscribe")
_HEALTH = Rule(_LOOK, ("/system/status",))
_ESTOP = Rule(("discover", "read", "subscribe", "execute"), ("/system/estop",))
_OWN = Rule(_LOOK, ("/system/commands", "/system/sessions"))
_LEASES = Rule((*_LOOK, "execute"), ("/system/leases",))
BUILTIN_ROLES: dict[str, Role] = {
    "viewer": Role(allow=(Rule(_LOOK, ("/**",)), _HEALTH, _ESTOP)),
    "operator": Role(allow=(Rule(("*",), ("/**",)), _HEALTH, _ESTOP, _OWN, _LEASES)),
    "agent": Role(allow=(Rule(("*",), ("/**",)), _HEALTH, _ESTOP, _OWN, _LEASES), priority=10),
    "admin": Role(allow=(Rule(("*",), ("/**", "/system/**")),), reset=True, priority=60),
}
"""Roles that need no configuration: look, operate, operate as a program that gives way to people,
and all of it with the gateway's own branch."""


_Reach = tuple[Pattern, Operation, str]
"""A pattern, what it is about, and the tenant in which it counts (`*`: in all)."""


class Rights:
    """The compiled rules of one set of grants."""

    __slots__ = ("_allow", "_deny", "_held", "_masks", "tenants")

    def __init__(self, grants: Grants, roles: dict[str, Role]) -> None:
        self.tenants = tuple(tenant for tenant, _ in grants)
        self._held = [(t, roles[name]) for t, names in grants for name in names if name in roles]
        self._allow = [
            r for t, role in self._held for rule in role.allow for r in _reaches(rule, t)
        ]
        self._deny = [r for t, role in self._held for rule in role.deny for r in _reaches(rule, t)]
        self._masks: dict[str, int] = {}

    def may_reset(self, tenant: str | None) -> bool:
        """Tell whether a latched e-stop of a tenant's robot may be reset."""
        return any(role.reset for place, role in self._held if place in ("*", tenant))

    def priority(self, tenant: str | None) -> int:
        """Return the highest priority that a role gives in a tenant."""
        return max((role.priority for t, role in self._held if t in ("*", tenant)), default=0)

    def mask(self, path: str) -> int:
        """Return the allowed operations of an existing path, as bits of `Operation`."""
        mask = self._masks.get(path)
        if mask is None:
            if len(self._masks) > _MAX_KNOWN:
                self._masks.clear()
            mask = self._masks[path] = self._work_out(path)
        return mask

    def _work_out(self, path: str) -> int:
        tenant = tenant_of(path)
        allowed = denied = Operation.NONE
        for pattern, bits, place in self._allow:
            if bits & ~allowed and place in ("*", tenant) and pattern.matches(path):
                allowed |= bits
        for pattern, bits, place in self._deny:
            if place in ("*", tenant) and pattern.matches(path):
                denied |= bits
        if denied & Operation.DISCOVER:
            return 0
        mask = int(allowed & ~denied)
        return mask | int(Operation.DISCOVER) if mask else 0


def _reaches(rule: Rule, tenant: str) -> list[_Reach]:
    found: list[_Reach] = []
    for text in rule.paths:
        if text.startswith("/system/"):
            found.append((Pattern(text), rule.mask, "*"))
        elif text.startswith("/tenant/"):
            found.append((Pattern(text), rule.mask, tenant))
        else:
            found.append((Pattern(f"/tenant/{tenant}{text}"), rule.mask, tenant))
    return found


class Rules:
    """The roles of the gateway, and the rights compiled from them."""

    def __init__(self, roles: dict[str, Role]) -> None:
        self.roles = {**BUILTIN_ROLES, **roles}
        self._compiled: dict[Grants, Rights] = {}

    def rights(self, principal: Principal) -> Rights:
        """Return the rights of a principal; the same object for the same grants."""
        rights = self._compiled.get(principal.grants)
        if rights is None:
            rights = self._compiled[principal.grants] = Rights(principal.grants, self.roles)
        return rights
