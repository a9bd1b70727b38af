"""Which tests run beside which others: the phases of a run, one after the other, and their lanes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

__all__ = ["PHASES", "Lane", "chooses", "is_alongside", "needless", "unwritten"]

_TESTS = Path(__file__).parent
_ALONGSIDE = ("conformance", "kernel", "plugins/a2a", "plugins/client", "plugins/mcp")
"""Folders whose tests compute: they fill the cores that those leave idle who watch robots."""
_FLAG = re.compile(r"-[lqsvx]+|--[a-z-]+=.*|[^-].*", re.DOTALL)
"""What an argument is that takes the next one for no value of its own."""
_TELLING = re.compile(r"-[lqsvx]+|-r\w*|--(durations(-min)?|tb|color|timeout|verbosity)=.*")
"""Arguments that leave all tests to be run."""


@dataclass(frozen=True)
class Lane:
    """Processes of one pytest, and what they run."""

    processes: str
    tests: str

    def has_tests(self, arguments: Sequence[str]) -> bool:
        """Tell whether any file below those that pytest is given has some: starting it for none takes seconds."""
        tests = Path("tests")
        below = _below(arguments) or [tests if tests.is_dir() else Path()]
        files = (
            file for path in below for file in ([path] if path.is_file() else path.rglob("*.py"))
        )
        return any(
            file.name.startswith("test_") and not needless(file.resolve(), self.tests)
            for file in files
        )


_REST = Lane("auto", "not alongside and not paired and not serial")
_PAIRED = Lane("2", "paired and not serial")
_BESIDE = Lane("2", "alongside and not paired and not serial")
_SERIAL = Lane("1", "serial")
PHASES = (
    (_REST,),
    (_PAIRED, _BESIDE),
    (_SERIAL,),
)
_MARKS = {_PAIRED.tests: "paired", _SERIAL.tests: "serial"}


def chooses(arguments: Sequence[str]) -> bool:
    """Tell whether arguments of pytest may leave tests out, so that a lane may have none of its own."""
    return not all(_TELLING.fullmatch(each) for each in arguments)


def _below(arguments: Sequence[str]) -> list[Path]:
    """Return the paths among arguments, with those that may be values of options; none if all may be.

    What options take values only pytest and its plugins know. One path too many costs seconds.
    """
    before = ["", *arguments]
    given = [
        (Path(each), bool(_FLAG.fullmatch(option)) or not option)
        for option, each in zip(before, arguments, strict=False)
        if not each.startswith("-") and Path(each).exists()
    ]
    return [path for path, _ in given] if any(sure for _, sure in given) else []


def is_alongside(path: Path) -> bool:
    """Tell whether a file's tests have a lane of their own beside those that are `paired`."""
    return any(path.is_relative_to(_TESTS / folder) for folder in _ALONGSIDE)


def needless(path: Path, tests: str) -> bool:
    """Tell whether a file has none of the tests, so that it need not be imported."""
    if path.suffix != ".py" or not path.name.startswith("test_"):
        return False
    if tests in _MARKS:
        return not _names(path, _MARKS[tests])
    if tests == _REST.tests:
        return is_alongside(path)
    return tests == _BESIDE.tests and not is_alongside(path)


def unwritten(item: pytest.Item) -> Iterator[str]:
    """Name the marks that choose a test's lane and are not written in its file: no lane would run it."""
    for mark in _MARKS.values():
        if item.get_closest_marker(mark) and not _names(item.path, mark):
            yield mark


@cache
def _names(path: Path, mark: str) -> bool:
    return f"mark.{mark}" in path.read_text(encoding="utf-8")
