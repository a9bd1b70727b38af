"""What a principal may do: roles of allow and deny rules, compiled to one bit mask for each path.

Deny wins, and nothing is allowed that no rule allows. A rule's pattern without `/tenant/` counts
in every tenant that the principal acts in. The mask of a path is worked out once for each set of
roles and kept until the tree or the rules change, so a request costs one dictionary access.
"""

from __future__ import annotations

from typing import Literal

import msgspec

from rcp_kernel.identity import Principal
from rcp_kernel.model import Operation, Pattern

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


_LOOK: tuple[OperationName, ...] = ("discover", "read", "subscribe")
_HEALTH = Rule(_LOOK, ("/system/status",))
_ESTOP = Rule(("discover", "read", "subscribe", "execute"), ("/system/estop",))
_OWN = Rule(_LOOK, ("/system/commands", "/system/sessions", "/system/leases"))
BUILTIN_ROLES: dict[str, Role] = {
    "viewer": Role(allow=(Rule(_LOOK, ("/**",)), _HEALTH, _ESTOP)),
    "operator": Role(allow=(Rule(("*",), ("/**",)), _HEALTH, _ESTOP, _OWN)),
    "admin": Role(allow=(Rule(("*",), ("/**", "/system/**")),), reset=True),
}
"""Roles that need no configuration: look, operate, and all of it with the gateway's own branch."""


class Rights:
    """The compiled rules of one set of roles in one set of tenants."""

    __slots__ = ("_allow", "_deny", "_masks", "may_reset", "tenants")

    def __init__(self, principal: Principal, roles: dict[str, Role]) -> None:
        self.tenants = principal.tenants
        held = [roles[name] for name in principal.roles if name in roles]
        self.may_reset = any(role.reset for role in held)
        self._allow = [pair for role in held for rule in role.allow for pair in self._compile(rule)]
        self._deny = [pair for role in held for rule in role.deny for pair in self._compile(rule)]
        self._masks: dict[str, int] = {}

    def _compile(self, rule: Rule) -> list[tuple[Pattern, Operation]]:
        pairs: list[tuple[Pattern, Operation]] = []
        for text in rule.paths:
            if text.startswith(("/tenant/", "/system/")):
                pairs.append((Pattern(text), rule.mask))
                continue
            pairs.extend((Pattern(f"/tenant/{tenant}{text}"), rule.mask) for tenant in self.tenants)
        return pairs

    def mask(self, path: str) -> int:
        """Return the allowed operations of an existing path, as bits of `Operation`."""
        mask = self._masks.get(path)
        if mask is None:
            if len(self._masks) > _MAX_KNOWN:
                self._masks.clear()
            mask = self._masks[path] = self._work_out(path)
        return mask

    def _work_out(self, path: str) -> int:
        allowed = denied = Operation.NONE
        for pattern, bits in self._allow:
            if bits & ~allowed and self._reaches(pattern, path):
                allowed |= bits
        for pattern, bits in self._deny:
            if self._reaches(pattern, path):
                denied |= bits
        if denied & Operation.DISCOVER:
            return 0
        mask = int(allowed & ~denied)
        return mask | int(Operation.DISCOVER) if mask else 0

    def _reaches(self, pattern: Pattern, path: str) -> bool:
        if not pattern.matches(path):
            return False
        if path.startswith("/system/") or "*" in self.tenants:
            return True
        # A role's pattern may name tenants of others; only those of the principal count.
        return path.split("/", 3)[2] in self.tenants


class Rules:
    """The roles of the gateway, and the rights compiled from them."""

    def __init__(self, roles: dict[str, Role]) -> None:
        self.roles = {**BUILTIN_ROLES, **roles}
        self._compiled: dict[tuple[tuple[str, ...], tuple[str, ...]], Rights] = {}

    def rights(self, principal: Principal) -> Rights:
        """Return the rights of a principal; the same object for the same roles and tenants."""
        key = (principal.tenants, principal.roles)
        rights = self._compiled.get(key)
        if rights is None:
            rights = self._compiled[key] = Rights(principal, self.roles)
        return rights
