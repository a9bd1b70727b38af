"""Rules against a plain model: deny wins, default nothing, tenants share nothing."""

from __future__ import annotations

from itertools import product

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcp_kernel.access.acl import Rights, Rules
from rcp_kernel.config.role import BUILTIN_ROLES, Role, Rule
from rcp_kernel.contract.identity import Principal, granted
from rcp_kernel.model import Operation, Pattern

OPERATIONS = ("discover", "read", "write", "execute", "subscribe")
patterns = st.sampled_from(
    ["/**", "/sensor/**", "/sensor/*", "/param/speed", "/tenant/*/sensor/pose", "/tenant/b/**", "/*/x"]
)  # fmt: skip
rules = st.builds(
    Rule,
    operations=st.lists(st.sampled_from([*OPERATIONS, "*"]), min_size=1, max_size=3).map(tuple),
    paths=st.lists(patterns, min_size=1, max_size=2).map(tuple),
)
roles = st.builds(
    Role, allow=st.lists(rules, max_size=3).map(tuple), deny=st.lists(rules, max_size=2).map(tuple)
)
PATHS = [
    f"/tenant/{tenant}/{rest}"
    for tenant in "ab"
    for rest in ("sensor/pose", "sensor/x", "sensor/arm/x", "param/speed", "action/x")
]


def plainly(principal: Principal, held: list[Role], path: str) -> set[str]:
    """Work out the rights as the contract says them."""
    tenant = path.split("/")[2]
    if "*" not in principal.tenants and tenant not in principal.tenants:
        return set()

    def reached(found: Rule) -> bool:
        texts = [t if t.startswith("/tenant/") else f"/tenant/{tenant}{t}" for t in found.paths]
        return any(Pattern(text).matches(path) for text in texts)

    def names(chosen: list[Rule]) -> set[str]:
        return {
            n
            for r in chosen
            if reached(r)
            for o in r.operations
            for n in (OPERATIONS if o == "*" else [o])
        }

    denied = names([r for role in held for r in role.deny])
    allowed = names([r for role in held for r in role.allow]) - denied
    if not allowed or "discover" in denied:
        return set()
    return allowed | {"discover"}


@given(
    st.lists(roles, min_size=1, max_size=2),
    st.sampled_from([("a",), ("b",), ("a", "b"), ("*",)]),
    st.sampled_from(PATHS),
)
def test_rights_are_what_the_rules_plainly_say(
    held: list[Role], tenants: tuple[str, ...], path: str
) -> None:
    named = {f"r{i}": role for i, role in enumerate(held)}
    principal = Principal("p", granted(tenants, named))
    mask = Rules(named).rights(principal).mask(path)
    assert {n for n in OPERATIONS if mask & Operation[n.upper()]} == plainly(principal, held, path)


def test_a_principal_without_a_role_sees_nothing() -> None:
    rights = Rules({}).rights(Principal("p", granted(("*",), ())))
    assert all(rights.mask(path) == 0 for path in [*PATHS, "/system/status"])


def test_a_viewer_looks_and_does_not_move() -> None:
    rights = Rules({}).rights(Principal("p", granted(("a",), ("viewer",))))
    assert rights.mask("/tenant/a/sensor/pose") & Operation.SUBSCRIBE
    assert not rights.mask("/tenant/a/param/speed") & Operation.WRITE
    assert not rights.mask("/tenant/a/action/x") & Operation.EXECUTE
    assert rights.mask("/tenant/b/sensor/pose") == 0


def test_whoever_may_see_a_robot_may_stop_it_and_only_an_admin_may_reset() -> None:
    for name in BUILTIN_ROLES:
        rights = Rules({}).rights(Principal("p", granted(("a",), (name,))))
        assert rights.mask("/system/estop") & Operation.EXECUTE
        assert rights.may_reset("a") is (name == "admin")


FOLDERS = ("a", "a/b", "b/a", "a/a/b", "b/b/a/a")
PATTERNS = (
    "",
    "/a",
    "/*",
    "/**",
    "/a/*",
    "/*/a",
    "/a/**",
    "/**/a",
    "/**/*",
    "/*/b/**",
    "/b/b/**/a",
)


@pytest.mark.parametrize("deny", PATTERNS)
@pytest.mark.parametrize("allow", PATTERNS)
def test_a_mask_that_a_folder_has_in_common_is_that_of_each_path_in_it(
    allow: str, deny: str
) -> None:
    rules = [{"operations": ["read"], "paths": [f"/sensor{allow or '/b'}"]}]
    none = [{"operations": ["read"], "paths": [f"/sensor{deny}"]}] if deny else []
    role = msgspec.convert({"allow": rules, "deny": none}, Role)
    kept, alone = (Rights((("alpha", ("own",)),), {"own": role}) for _ in range(2))
    for folder, name in product(FOLDERS, ("a", "b", "c")):
        path = f"/tenant/alpha/sensor/{folder}/{name}"
        assert kept.mask(path) == alone.compute_mask(path), path


def test_thousands_of_paths_in_a_folder_are_looked_up_in_the_rules_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    requests: list[str] = []
    usual = Rights.compute_mask

    def compute_mask(self: Rights, path: str) -> int:
        requests.append(path)
        return usual(self, path)

    monkeypatch.setattr(Rights, "compute_mask", compute_mask)
    rules = [{"operations": ["read"], "paths": ["/sensor/a/**", "/sensor/b/first"]}]
    role = msgspec.convert({"allow": rules}, Role)
    rights = Rights((("alpha", ("own",)),), {"own": role})
    for folder, number in product("abc", range(1000)):
        rights.mask(f"/tenant/alpha/sensor/{folder}/{number}")
    assert len(requests) == 1002  # in b each by itself, as one rule names a path there
