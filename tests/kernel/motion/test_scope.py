"""A scope is a part of a tenant by whole segments, and overlaps whatever shares a path with it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcp_kernel.errors import InvalidPath
from rcp_kernel.model import BRANCHES
from rcp_kernel.tree.scope import Scope


@pytest.mark.parametrize(
    ("scope", "path", "covered"),
    [
        ("/tenant/a", "/tenant/a/actuator/x", True),
        ("/tenant/a", "/tenant/ab/actuator/x", False),
        ("/tenant/a/actuator", "/tenant/a/actuator/x/y", True),
        ("/tenant/a/actuator", "/tenant/a/action/x", False),
        ("/tenant/a/actuator/x", "/tenant/a/actuator/x", True),
        ("/tenant/a/actuator/x", "/tenant/a/actuator/xy", False),
        ("/tenant/a/drone1", "/tenant/a/actuator/drone1/thrust", True),
        ("/tenant/a/drone1", "/tenant/a/actuator/drone10/thrust", False),
        ("/tenant/a/drone1", "/tenant/b/actuator/drone1/thrust", False),
        ("/actuator", "/tenant/own/actuator/x", True),
    ],
)
def test_a_scope_covers_whole_segments(scope: str, path: str, *, covered: bool) -> None:
    assert Scope(scope, "own").covers(path) is covered


@pytest.mark.parametrize(
    "text", ["", "/", "/tenant", "/system/status", "/tenant/a/*", "/tenant/a/drone1/x", "alpha"]
)
def test_what_is_no_part_of_a_tenant_is_no_scope(text: str) -> None:
    with pytest.raises(InvalidPath):
        Scope(text, "own")


_names = st.sampled_from(["x", "y"])
_scopes = st.one_of(
    st.just([]),
    _names.map(lambda robot: [robot]),
    st.builds(
        lambda branch, rest: [branch, *rest],
        st.sampled_from(["actuator", "action"]),
        st.lists(_names, max_size=2),
    ),
).map(lambda parts: Scope("/".join(["/tenant/a", *parts])))
_PATHS = [
    f"/tenant/a/{branch}/{one}{two}{three}"
    for branch in BRANCHES
    for one in "xy"
    for two in ("", "/x", "/y")
    for three in ("", "/x", "/y")
    if two or not three
]


@given(_scopes, _scopes)
def test_scopes_overlap_when_some_path_may_lie_in_both(one: Scope, two: Scope) -> None:
    shared = any(one.covers(path) and two.covers(path) for path in _PATHS)
    assert one.overlaps(two) is two.overlaps(one) is shared
