"""The page of the test kit has all that an author gives and uses, and nothing else."""

from __future__ import annotations

import inspect
from typing import Any

import pytest

import rcp_gateway.testing as kit
from docs.pages import DOCS, keys, rows, section

PAGE = DOCS / "test-kit.md"
COMMON = set(keys(section(PAGE, "Every suite")))


def names(suite: type) -> set[str]:
    """Return what a subclass sees, but for the tests."""
    fields = {name for base in suite.__mro__ for name in getattr(base, "__annotations__", {})}
    found = {name for name, _ in inspect.getmembers(suite)} | fields
    return {name for name in found if not name.startswith(("_", "test"))}


def told(heading: str) -> set[str]:
    return set(keys(section(PAGE, f"`{heading}`")))


@pytest.mark.parametrize(
    ("suite", "base"),
    [
        (kit.BackendSuite, None),
        (kit.StopSuite, kit.BackendSuite),
        (kit.ProfileSuite, kit.BackendSuite),
        (kit.TransportSuite, None),
        (kit.AdapterSuite, None),
        (kit.FeatureSuite, None),
    ],
    ids=lambda one: getattr(one, "__name__", ""),
)
def test_a_suite_is_told(suite: Any, base: Any) -> None:
    known = COMMON | told(suite.__name__) | (told(base.__name__) if base else set())
    internal = {"running", "prompt"}  # of the fixture `robot`
    assert names(suite) - internal - COMMON == known - COMMON


def test_what_is_beside_the_suites_is_told() -> None:
    beside = {
        name for row in rows(section(PAGE, "Beside the suites")) for name in keys(f"| {row[0]} |")
    }
    suites = {name for name in kit.__all__ if name.endswith("Suite") and name != "Suite"}
    assert beside == set(kit.__all__) - suites
