"""Which tests run beside which others: the phases of a run, one after the other, and their lanes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

__all__ = ["PHASES", "Lane", "is_alongside", "needless"]

_TESTS = Path(__file__).parent
_ALONGSIDE = ("conformance", "kernel", "plugins/a2a", "plugins/client", "plugins/mcp")
"""Folders whose tests compute: they fill the cores that those leave idle who watch robots."""


@dataclass(frozen=True)
class Lane:
    """Processes of one pytest, and what they run."""

    processes: str
    tests: str

    def has_tests(self, arguments: Iterable[str]) -> bool:
        """Tell whether any file below those that pytest is given has some: starting it for none takes seconds."""
        given = [path for path in map(Path, arguments) if path.exists()]
        tests = Path("tests")
        below = given or [tests if tests.is_dir() else Path()]
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
_MARKS = {_PAIRED.tests: "mark.paired", _SERIAL.tests: "mark.serial"}


def is_alongside(path: Path) -> bool:
    """Tell whether a file's tests have a lane of their own beside those that are `paired`."""
    return any(path.is_relative_to(_TESTS / folder) for folder in _ALONGSIDE)


def needless(path: Path, tests: str) -> bool:
    """Tell whether a file has none of the tests, so that it need not be imported."""
    if path.suffix != ".py" or not path.name.startswith("test_"):
        return False
    if tests in _MARKS:
        return _MARKS[tests] not in path.read_text(encoding="utf-8")
    if tests == _REST.tests:
        return is_alongside(path)
    return tests == _BESIDE.tests and not is_alongside(path)
