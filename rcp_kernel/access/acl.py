"""Authorization: roles of allow and deny rules, compiled to one bit mask per path.

Deny takes precedence, and anything that no rule allows is denied. Roles are granted per tenant: a
rule applies only in the tenant in which its role is held, whatever its pattern, and to `/system/`.
The mask of a path is computed once per set of roles and cached until the rules change, so a request
costs one dictionary lookup. Where no rule distinguishes the paths of a folder, it is computed once for
the folder: twenty thousand paths under new rules cost milliseconds. Conditions are evaluated only if
the other rules do not decide.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakSet

import msgspec

from rcp_conditions import Condition, condition
from rcp_kernel.config.role import ASK, BUILTIN_ROLES, DECIDE, OPERATIONS, Role, Rule
from rcp_kernel.contract.identity import Grants, Principal
from rcp_kernel.contract.paths import can_name_resource
from rcp_kernel.model import Operation, Pattern, tenant_of

if TYPE_CHECKING:
    from rcp_kernel.access.conditions import Conditions
    from rcp_kernel.tree.entry import Entry

__all__ = ["Rights", "Rules", "reach"]

_NO_GRANTS: Mapping[str, Sequence[Rule]] = MappingProxyType({})
_MAX_KNOWN = 200_000  # paths with cached masks, over all sets of roles
_MAX_COMPILED = 1000  # sets of roles with cached rights
_NAMED = re.compile(r"/tenant/[\w./-]+")
_CONDITIONAL_SHIFT = 8  # bits by which conditional operations are shifted
# Masks are plain integers: Python makes a new flag of each `&` of two flags, at thirty times the cost.
_DISCOVER = int(Operation.DISCOVER)
_EVERY = int(OPERATIONS)


class _Reach(NamedTuple):
    """A rule with one of its patterns, in the tenant where it counts (`*`: in all)."""

    pattern: Pattern
    bits: int
    """Its operations."""
    tenant: str
    role_tenant: str
    """The tenant of the role."""
    when: Condition | None


class _Terms(NamedTuple):
    """The rules for one path that depend on conditions."""

    allowed: int
    """Allowed without one."""
    allow: list[_Reach]
    deny: list[_Reach]


def reach(mask: int) -> int:
    """Return the operations that a mask allows under some condition or none."""
    return (mask | mask >> _CONDITIONAL_SHIFT) & _EVERY


class Rights:
    """The compiled rules of one set of grants."""

    __slots__ = (
        "__weakref__",
        "_allow",
        "_asked",
        "_budget",
        "_conditions",
        "_deny",
        "_folders",
        "_granted",
        "_terms",
        "approve",
        "grants",
        "masks",
        "tenants",
    )

    def __init__(
        self,
        grants: Grants,
        roles: dict[str, Role],
        conditions: Conditions | None = None,
        budget: CacheBudget | None = None,
    ) -> None:
        self.grants = grants
        self.tenants = tuple(tenant for tenant, _ in grants)
        self._granted = [(t, roles[name]) for t, names in grants for name in names if name in roles]
        self._allow = [
            r
            for t, role in self._granted
            for rule in (*role.allow, *_implied(role))
            for r in _reaches(rule, t)
        ]
        self._deny = [
            r._replace(bits=r.bits if r.when is None else r.bits & ~_DISCOVER)
            for t, role in self._granted
            for rule in role.deny
            for r in _reaches(rule, t)
        ]
        self.approve = [
            r
            for t, role in self._granted
            if role.approve
            for r in _reaches(Rule(("write", "execute"), role.approve), t)
        ]
        """Where a person must approve commands; usually empty."""
        self._asked: dict[str, bool] = {}
        self._conditions = conditions
        self._budget = budget or CacheBudget()
        self._budget.users.add(self)
        self._terms: dict[str, _Terms] = {}
        self._folders: dict[str, int | None] = {}
        """The mask of all that is in a folder; None if rules distinguish paths within the folder."""
        self.masks: dict[str | None, int] = {}
        """Cached masks, by path."""

    def may_reset(self, tenant: str | None) -> bool:
        """Return whether a latched e-stop of a tenant's robot may be reset."""
        return any(role.reset for place, role in self._granted if place in ("*", tenant))

    def may_stop_all(self) -> bool:
        """Return whether one e-stop may stop the robots of several tenants."""
        return any(role.stop_all for _, role in self._granted)

    def asks(self, path: str) -> bool:
        """Return whether a person has to approve commands on a path first."""
        if not self.approve:
            return False
        found = self._asked.get(path)
        if found is None:
            self._budget.take()
            found = self._asked[path] = bool(self._matching(self.approve, path))
        return found

    def may_approve(self, tenant: str | None) -> bool:
        """Return whether requests of other principals in a tenant may be approved."""
        return any(role.may_approve for place, role in self._granted if place in ("*", tenant))

    def may_approve_own(self, tenant: str | None) -> bool:
        """Return whether the person at an adapter's client may approve its own requests."""
        return any(role.approve_own for place, role in self._granted if place in ("*", tenant))

    def priority(self, tenant: str | None) -> int:
        """Return the highest priority that a role gives in a tenant."""
        return max((role.priority for t, role in self._granted if t in ("*", tenant)), default=0)

    def places(self, path: str, operation: Operation) -> tuple[str, ...]:
        """List the tenants whose own roles allow an operation on a path of `/system/`.

        Such a path is shared by all tenants: what it shows has to be separated by these.
        """
        if not self.mask(path) & operation:
            return ()
        return tuple(
            dict.fromkeys(
                r.role_tenant
                for r in self._allow
                if r.bits & operation and r.when is None and r.pattern.matches(path)
            )
        )

    def mask(self, path: str) -> int:
        """Return the operations allowed on an existing path in any state, as bits of `Operation`.

        Zero means that the path is hidden. Higher bits stand for conditional operations: see
        `reach`.
        """
        mask = self.masks.get(path)
        if mask is None:
            mask = self._mask_in(path.rpartition("/")[0], path)
            self.remember(path, mask)
        return mask

    def _mask_in(self, folder: str, path: str) -> int:
        """Compute the mask of an existing path, or take that of its folder.

        Requested paths that do not exist would fill the memory, and the time taken would reveal whether
        the folder exists.
        """
        try:
            known = self._folders[folder]
        except KeyError:
            self._budget.take()
            alike = not any(_tells_apart(r.pattern.text, folder) for r in self._near(folder))
            known = self._folders[folder] = self.compute_mask(path) if alike else None
        return self.compute_mask(path) if known is None else known

    def _near(self, folder: str) -> Iterator[_Reach]:
        tenant = tenant_of(folder)
        return (r for r in (*self._allow, *self._deny) if r.tenant in ("*", tenant))

    def hides(self, text: str) -> bool:
        """Return whether a text is a path, existing or not, that is hidden."""
        for found in _NAMED.findall(text):
            path = found.rstrip(".")
            if can_name_resource(path) and not (self.masks.get(path) or self.compute_mask(path)):
                return True
        return False

    def remember(self, path: str, mask: int) -> None:
        """Keep the mask of an existing path."""
        if path not in self.masks:
            self._budget.take()
        self.masks[path] = mask

    def compute_mask(self, path: str) -> int:
        """Compute the mask of a path, whether it exists or not."""
        allow, deny = self._matching(self._allow, path), self._matching(self._deny, path)
        sure = _bits(r for r in allow if r.when is None)
        denied = _bits(r for r in deny if r.when is None)
        if denied & _DISCOVER:
            return 0
        possible = _bits(allow) & ~denied
        if not possible:
            return 0
        sure &= ~denied & ~_bits(r for r in deny if r.when is not None)
        perhaps = possible & ~sure & ~_DISCOVER
        return sure | _DISCOVER | perhaps << _CONDITIONAL_SHIFT

    @staticmethod
    def _matching(rules: list[_Reach], path: str) -> list[_Reach]:
        tenant = tenant_of(path)
        return [r for r in rules if r.tenant in ("*", tenant) and r.pattern.matches(path)]

    def permits(self, entry: Entry, operation: Operation) -> bool:
        """Return whether an operation is allowed now."""
        mask, bits = self.mask(entry.path), int(operation)
        if mask & bits:
            return True
        return (
            bool(mask >> _CONDITIONAL_SHIFT & bits)
            and self.blocking_condition(entry, operation) is None
        )

    def depends(self, entry: Entry, operation: Operation) -> bool:
        """Return whether an operation is allowed only under a condition."""
        return bool(self.mask(entry.path) >> _CONDITIONAL_SHIFT & operation)

    def blocking_condition(self, entry: Entry, operation: Operation) -> Condition | None:
        """Return the condition that currently refuses an operation; None if it is allowed."""
        conditions = self._conditions
        terms = self._terms_of(entry.path)
        for one in terms.deny:
            unless = one.when if one.bits & operation else None
            if unless and (conditions is None or conditions.holds(unless, entry) is not False):
                return unless
        if terms.allowed & operation:
            return None
        wanted = [r.when for r in terms.allow if r.bits & operation and r.when is not None]
        if conditions is not None and any(conditions.holds(when, entry) for when in wanted):
            return None
        return wanted[0]

    def _terms_of(self, path: str) -> _Terms:
        terms = self._terms.get(path)
        if terms is None:
            allow, deny = self._matching(self._allow, path), self._matching(self._deny, path)
            self._budget.take()
            terms = self._terms[path] = _Terms(
                _bits(r for r in allow if r.when is None),
                [r for r in allow if r.when is not None],
                [r for r in deny if r.when is not None],
            )
        return terms

    def shows(self, condition: Condition, entry: Entry) -> bool:
        """Return whether all values that a condition uses may be read."""
        if self._conditions is None:
            return False
        found = [self._conditions.resource(ref, entry) for ref in condition.refs]
        return all(one and self.mask(one[0].path) & Operation.READ for one in found)

    def forget(self) -> None:
        """Clear the cached masks."""
        self.masks.clear()
        self._folders.clear()
        self._terms.clear()
        self._asked.clear()


class CacheBudget:
    """Limits how many paths all rights together cache."""

    def __init__(self) -> None:
        self.users: WeakSet[Rights] = WeakSet()
        self._taken = 0

    def take(self) -> None:
        """Count one more path; beyond the limit, all of them are forgotten."""
        self._taken += 1
        if self._taken > _MAX_KNOWN:
            self._taken = 1
            for rights in self.users:
                rights.forget()


def _bits(rules: Iterable[_Reach]) -> int:
    bits = 0
    for one in rules:
        bits |= one.bits
    return bits


def _tells_apart(text: str, folder: str) -> bool:
    """Return whether a pattern may match one path in a folder and not another, by the name alone."""
    head, _, last = text.rpartition("/")
    if last == "**" and _pattern(text).matches(folder):  # and so everything below it
        return False
    if last == "*" or not head:
        return False
    return _tells_apart(head, folder) if last == "**" else _pattern(head).matches(folder)


@lru_cache(maxsize=4096)
def _pattern(text: str) -> Pattern:
    return Pattern(text)


def _implied(role: Role) -> tuple[Rule, ...]:
    """Return the implied rules: a role that decides on or needs approvals may see them."""
    if role.may_approve:
        return (DECIDE,)
    return (ASK,) if role.approve else ()


def _reaches(rule: Rule, tenant: str) -> list[_Reach]:
    found: list[_Reach] = []
    when = None if rule.when is None else condition(rule.when)
    bits = int(rule.mask)
    for text in rule.paths:
        if text.startswith("/system/"):
            found.append(_Reach(Pattern(text), bits, "*", tenant, when))
        elif text.startswith("/tenant/"):
            found.append(_Reach(Pattern(text), bits, tenant, tenant, when))
        else:
            found.append(_Reach(Pattern(f"/tenant/{tenant}{text}"), bits, tenant, tenant, when))
    return found


class Rules:
    """The roles of the gateway, and the rights compiled from them."""

    def __init__(
        self,
        roles: dict[str, Role],
        conditions: Conditions | None = None,
        grants: Mapping[str, Sequence[Rule]] = _NO_GRANTS,
    ) -> None:
        """`grants` are rules that features add to built-in roles."""
        self._conditions = conditions
        self._built_in = {
            name: msgspec.structs.replace(role, allow=(*role.allow, *grants.get(name, ())))
            for name, role in BUILTIN_ROLES.items()
        }
        self.configure(roles)

    def configure(self, roles: dict[str, Role]) -> None:
        """Apply other roles; new sessions do not use rights compiled from previous ones."""
        self.roles = {**self._built_in, **roles}
        self._budget = CacheBudget()
        self._compiled: dict[Grants, Rights] = {}
        conditions = self._conditions
        if conditions is not None:
            rules = [r for role in self.roles.values() for r in (*role.allow, *role.deny)]
            conditions.use("rules", [condition(r.when) for r in rules if r.when is not None])

    def rights(self, principal: Principal) -> Rights:
        """Return the rights of a principal; the same object for the same grants."""
        rights = self._compiled.get(principal.grants)
        if rights is None:
            if len(self._compiled) >= _MAX_COMPILED:
                del self._compiled[next(iter(self._compiled))]
            rights = Rights(principal.grants, self.roles, self._conditions, self._budget)
            self._compiled[principal.grants] = rights
        return rights
