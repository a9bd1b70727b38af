"""What the failures of a run mean: broken, or sensitive to a busy machine. See decision 0020."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from failures import Failure

__all__ = ["HEADING", "tell"]

HEADING = "=== tests that failed"
"""Begins the last part of the output."""
_EXCUSED = 5  # failures that a busy machine may explain, one in a thousand; more of them are something else
_TIMES = 2  # that each has to pass alone
_ALONE = 20  # failures that are run again; more of them need no diagnosis
_LENGTH = 1000  # characters of a reason


def tell(failures: list[Failure], passes: Callable[[Failure], bool]) -> int:
    """Run each failure again, alone, and say at the very end what it means; the exit code.

    0 only if every single one of at most a few passes alone, several times in a row. A process that
    ended under a test, or hung in it, is a failure like others: that test is run again too.
    """
    unclear = _why_unclear(failures)
    sensitive, broken = ([], failures) if unclear else _sorted(failures, passes)
    excused = bool(sensitive) and not broken and len(sensitive) <= _EXCUSED
    found = unclear or "fails alone too"
    for line in _told(sensitive, broken, found, excused=excused):
        print(line, flush=True)  # noqa: T201 - what follows the output of pytest
    return 0 if excused else 1


def _why_unclear(failures: list[Failure]) -> str:
    if any(each.cut_short for each in failures):
        return "not run again: the run was cut short"
    return "not run again: there are too many" if len(failures) > _ALONE else ""


def _sorted(
    failures: list[Failure], passes: Callable[[Failure], bool]
) -> tuple[list[Failure], list[Failure]]:
    sensitive: list[Failure] = []
    broken: list[Failure] = []
    for each in failures:
        alone = all(passes(each) for _ in range(_TIMES))
        (sensitive if alone else broken).append(each)
    return sensitive, broken


def _told(
    sensitive: list[Failure], broken: list[Failure], found: str, *, excused: bool
) -> Iterator[str]:
    yield f"\n{HEADING}: {len(sensitive) + len(broken)}"
    for each in broken:
        yield _line(each, found)
    if sensitive:
        yield f"SENSITIVE TO LOAD: mend (each passed {_TIMES} times alone)"
    for each in sensitive:
        yield _line(each, "passes alone")
    if excused:
        yield "Nothing else failed: the run passes."


def _line(failure: Failure, found: str) -> str:
    return f"FAILED {failure.test} [{found}] - {failure.reason:.{_LENGTH}}"
