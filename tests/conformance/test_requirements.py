"""Requirements and tests are linked both ways: none unproved, none that proves nothing known."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from rcp_gateway.testing import REQUIREMENTS, TransportSuite

HERE = sorted(Path(__file__).parent.glob("test_*.py"))
SECTIONS = range(2, 12)


def collected(module: ModuleType) -> dict[str, Any]:
    """Return every test of a module that is collected, by name."""
    found: dict[str, Any] = {}
    for name, item in vars(module).items():
        if name.startswith("test_") and callable(item):
            found[name] = item
        elif name.startswith("Test") and isinstance(item, type):
            found |= {
                f"{name}.{n}": getattr(item, n)
                for n in dir(item)
                if n.startswith("test_") and getattr(item, n) is not None
            }
    return found


@pytest.fixture(scope="module")
def proofs() -> dict[str, list[str]]:
    """The collected tests that prove each requirement."""
    found: dict[str, list[str]] = {id_: [] for id_ in REQUIREMENTS}
    for path in HERE:
        for name, test in collected(importlib.import_module(f"conformance.{path.stem}")).items():
            for id_ in getattr(test, "proves", ()):
                found[id_].append(f"{path.stem}.{name}")
    return found


def test_every_requirement_is_proved_or_a_known_gap(proofs: dict[str, list[str]]) -> None:
    unproved = [id_ for id_, tests in proofs.items() if not tests and not REQUIREMENTS[id_].gap]
    assert unproved == []
    kept = [id_ for id_, tests in proofs.items() if tests and REQUIREMENTS[id_].gap]
    assert kept == [], "no gap any more"


def test_every_requirement_is_proved_on_each_wire_that_it_applies_to(
    proofs: dict[str, list[str]],
) -> None:
    wires = {"test_memory", "test_websocket", "test_http", "test_sse"}
    for id_, tests in proofs.items():
        needs = REQUIREMENTS[id_].needs
        if needs or REQUIREMENTS[id_].gap:
            continue
        assert {test.partition(".")[0] for test in tests} >= wires, id_


def test_every_test_of_the_suite_names_what_it_proves() -> None:
    for name in dir(TransportSuite):
        if (
            name.startswith("test_")
            and name != "test_no_test_of_the_suite_is_changed_without_a_reason"
        ):
            assert getattr(TransportSuite, name).proves, name


def test_every_requirement_is_a_sentence_of_a_section() -> None:
    for id_, requirement in REQUIREMENTS.items():
        assert requirement.section in SECTIONS, id_
        assert requirement.text.endswith("."), id_
        assert len({r.text for r in REQUIREMENTS.values()}) == len(REQUIREMENTS)
