"""Paths and patterns against plain models of their semantics."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcp_kernel.errors import InvalidPath
from rcp_kernel.model import Pattern, Resource, full_path, kind_of, parse_path, tenant_of

segment = st.text("abc.-_1", min_size=1, max_size=3)
path = st.lists(segment, min_size=1, max_size=6).map(lambda parts: "/tenant/t/" + "/".join(parts))
pattern = st.lists(st.one_of(segment, st.just("*"), st.just("**")), min_size=1, max_size=5)


def plain_match(wanted: list[str], found: list[str]) -> bool:
    """The semantics as one would say them: `*` is one segment, `**` is any number."""
    if not wanted:
        return not found
    head, rest = wanted[0], wanted[1:]
    if head == "**":
        return any(plain_match(rest, found[i:]) for i in range(len(found) + 1))
    return bool(found) and head in ("*", found[0]) and plain_match(rest, found[1:])


@given(pattern.filter(lambda parts: parts.count("**") <= 3), path)
def test_a_pattern_matches_exactly_what_its_plain_reading_says(parts: list[str], full: str) -> None:
    compiled = Pattern("/tenant/t/" + "/".join(parts))
    assert compiled.matches(full) == plain_match(["tenant", "t", *parts], full[1:].split("/"))


@pytest.mark.parametrize(
    ("text", "full"),
    [
        ("/sensor/pose", "/tenant/alpha/sensor/pose"),
        ("/tenant/beta/sensor/pose", "/tenant/beta/sensor/pose"),
        ("/system/status", "/system/status"),
        ("/action/arm/move_to", "/tenant/alpha/action/arm/move_to"),
    ],
)
def test_a_relative_path_means_the_sessions_own_tenant(text: str, full: str) -> None:
    assert parse_path(text, "alpha") == full


@pytest.mark.parametrize(
    "text",
    ["", "/", "sensor/pose", "/sensor//pose", "/sensor/pose/", "/sensor/p o", "/nowhere/x", "/sensor/é",
     "/sensor/" + "a" * 600, "/sensor/pose\n", "/sensor/../x y"],
)  # fmt: skip
def test_what_is_not_a_path_is_refused(text: str) -> None:
    with pytest.raises(InvalidPath):
        parse_path(text, "alpha")


def test_a_relative_path_without_a_tenant_is_refused_with_the_way_out() -> None:
    with pytest.raises(InvalidPath) as caught:
        parse_path("/sensor/pose", None)
    assert "/tenant/" in caught.value.remedy


def test_a_pattern_with_many_deep_wildcards_is_refused_before_it_costs_time() -> None:
    with pytest.raises(InvalidPath):
        Pattern("/tenant/a" + "/**/x" * 20)


def test_a_robot_stands_one_level_deeper() -> None:
    assert full_path("alpha", "drone1", "sensor/attitude") == "/tenant/alpha/sensor/drone1/attitude"
    assert full_path("alpha", None, "sensor/pose") == "/tenant/alpha/sensor/pose"


def test_the_tenant_of_a_path_is_its_second_segment() -> None:
    assert tenant_of("/tenant/alpha/sensor/pose") == "alpha"
    assert tenant_of("/system/status") is None


@pytest.mark.parametrize("name", ["pose", "sensor/", "nothing/x", "/sensor/pose", "sensor/a b"])
def test_a_resource_needs_a_branch_and_a_name(name: str) -> None:
    with pytest.raises(InvalidPath):
        kind_of(name)
    with pytest.raises(InvalidPath):
        Resource(name=name, description="Wrong.")
