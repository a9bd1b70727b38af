"""What failed in a run of pytest, a line each in a file, for whoever started it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import pytest

__all__ = ["LISTED", "Failure", "failed", "failure", "keep", "note", "read"]

LISTED = "RCP_FAILURES"
"""The variable of the environment that names the file."""

_FAILED = pytest.StashKey[bool]()


@dataclass(frozen=True)
class Failure:
    """A test that failed, or whose file cannot be imported."""

    test: str
    reason: str
    cut_short: bool = False
    """It stands for tests that were not run, of which no test that is run again can speak."""


def failure(report: pytest.TestReport | pytest.CollectReport) -> Failure:
    """Tell why a test failed, in a line."""
    crash = getattr(report.longrepr, "reprcrash", None)
    text = crash.message if crash else str(report.longrepr).strip().rpartition("\n")[2]
    return Failure(report.nodeid, " ".join(text.split()))


def keep(item: pytest.Item, report: pytest.TestReport) -> None:
    """Keep for the fixtures of a test whether it failed."""
    item.stash[_FAILED] = report.failed or failed(item)


def failed(item: pytest.Item) -> bool:
    """Tell a fixture, in its own end, whether its test failed."""
    return item.stash.get(_FAILED, False)


def note(found: Failure, file: Path) -> None:
    """Add to the list."""
    with file.open("a", encoding="utf-8") as listed:
        listed.write(json.dumps(asdict(found)) + "\n")


def read(file: Path) -> list[Failure]:
    """Return all of them, each test once, in order."""
    if not file.exists():
        return []
    lines = file.read_text(encoding="utf-8").splitlines()
    found = [Failure(**json.loads(line)) for line in lines]
    first: dict[str, Failure] = {}
    for each in found:
        first.setdefault(each.test, each)
    return list(first.values())
