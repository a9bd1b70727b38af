"""`[roles.<name>]` and the built-in roles: named sets of rules, and their validation."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from rcp_conditions import ConditionTooCostly, condition
from rcp_kernel.contract.paths import ESTOP
from rcp_kernel.errors import ConfigError, InvalidPath
from rcp_kernel.model import Operation, Pattern

__all__ = [
    "ASK",
    "BUILTIN_ROLES",
    "DECIDE",
    "HUB",
    "OPERATIONS",
    "Role",
    "Rule",
    "check_pattern",
    "check_roles",
]

OperationName = Literal["discover", "read", "write", "execute", "subscribe", "*"]
OPERATIONS = (
    Operation.READ | Operation.WRITE | Operation.EXECUTE | Operation.SUBSCRIBE | Operation.DISCOVER
)
"""All that a rule can allow."""


class Rule(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Operations on the paths of some patterns."""

    operations: tuple[OperationName, ...]
    paths: tuple[str, ...]
    when: str | None = None
    """A condition: an `allow` applies only while true, a `deny` unless certainly false."""

    @property
    def mask(self) -> Operation:
        """The operations as bits."""
        bits = Operation.NONE
        for name in self.operations:
            bits |= OPERATIONS if name == "*" else Operation[name.upper()]
        return bits


class Role(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A named set of rules."""

    allow: tuple[Rule, ...] = ()
    deny: tuple[Rule, ...] = ()
    reset: bool = False
    """May reset a latched e-stop."""
    stop_all: bool = True
    """May stop the robots of all its tenants at once; without it an e-stop that names no scope
    stops those of the session's own tenant."""
    priority: Annotated[int, Meta(ge=0, le=100)] = 50
    """A higher priority takes over leases from a lower one: a person (50) from an agent (10)."""
    quota: dict[str, Any] | None = None
    """Quota of each principal with this role: a table that the feature's own type decodes."""
    approve: tuple[str, ...] = ()
    """Paths on which commands of this role require approval."""
    may_approve: bool = False
    """May decide on the approval requests of others."""
    approve_own: bool = False
    """The person at an adapter's client may approve the principal's own requests."""


_LOOK: tuple[OperationName, ...] = ("discover", "read", "subscribe")
_HEALTH = Rule(_LOOK, ("/system/status", "/system/tree"))
_STOP = Rule(("discover", "read", "subscribe", "execute"), (ESTOP,))
_OWN = Rule(_LOOK, ("/system/commands", "/system/sessions"))
ASK = Rule(_LOOK, ("/system/approvals",))
DECIDE = Rule((*_LOOK, "execute"), ("/system/approvals",))
HUB = "hub"
"""The role of a fleet's hub for its own requests: it views, and can stop."""
BUILTIN_ROLES: dict[str, Role] = {
    "viewer": Role(allow=(Rule(_LOOK, ("/**",)), _HEALTH, _STOP)),
    HUB: Role(allow=(Rule(_LOOK, ("/**",)), _HEALTH, _STOP)),
    "operator": Role(allow=(Rule(("*",), ("/**",)), _HEALTH, _STOP, _OWN)),
    "agent": Role(allow=(Rule(("*",), ("/**",)), _HEALTH, _STOP, _OWN), priority=10),
    "admin": Role(
        allow=(Rule(("*",), ("/**", "/system/**")),), reset=True, priority=60, may_approve=True
    ),
}
"""The built-in roles: view (a person, or a hub), operate, operate as a program that gives way to
people, and administer the gateway. Features add their own rules: `FeatureKind.grants`."""


def check_roles(roles: dict[str, Role], source: str) -> None:
    """Refuse rules with invalid paths, and invalid conditions.

    :raises ConfigError: with the file, the role and the rule.
    """
    for name, role in roles.items():
        for kind, rules in (("allow", role.allow), ("deny", role.deny)):
            for place, rule in enumerate(rules):
                _check(rule, f"{source}: [roles.{name}] {kind}[{place}]", deny=kind == "deny")
        for path in role.approve:
            where = f"{source}: [roles.{name}] approve"
            check_pattern(path, where)
            if path.startswith("/system/"):
                raise ConfigError(
                    f"{where} names {path}: operations of the gateway itself need no approval; "
                    "name paths of robots (a plan is approved for its steps on those paths)"
                )


def _check(rule: Rule, where: str, *, deny: bool) -> None:
    for path in rule.paths:
        check_pattern(path, where)
    if rule.when is None:
        return
    try:
        condition(rule.when)
    except ConditionTooCostly as error:
        raise ConfigError(f"{where} when: {error}. {error.remedy}") from None
    except ConfigError as error:
        raise ConfigError(f"{where} when: {error}") from None
    if deny and "discover" in rule.operations:
        raise ConfigError(
            f"{where} denies `discover` with a `when`: visibility must not change with the "
            "state; remove `when`, or deny other operations (`*` is all except discover)"
        )


def check_pattern(path: str, where: str) -> None:
    """Check a pattern.

    :raises ConfigError: it is not valid.
    """
    try:
        if not path.startswith("/"):
            raise InvalidPath(f"{path!r} does not begin with '/'")
        Pattern(path)
    except InvalidPath as error:
        raise ConfigError(f"{where} has a rule with an invalid path: {error.message}") from None
