"""Which failures of a run a busy machine may explain, and what is told of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from failures import Failure, note, read
from verdict import HEADING, tell

_MANY = 25


def _failures(count: int) -> list[Failure]:
    return [Failure(f"tests/test_{n}.py::test_it", f"reason {n}") for n in range(count)]


class _Alone:
    """Tests as they behave when they run by themselves."""

    def __init__(self, *results: bool) -> None:
        self.results = list(results)
        self.ran: list[str] = []

    def __call__(self, failure: Failure) -> bool:
        self.ran.append(failure.test)
        return self.results[len(self.ran) - 1]


def test_a_few_that_pass_alone_twice_are_told_and_excused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    alone = _Alone(*[True] * 10)
    assert tell(_failures(5), alone) == 0
    output = capsys.readouterr().out
    assert output.lstrip().startswith(HEADING)
    assert "SENSITIVE TO LOAD" in output
    assert "FAILED tests/test_2.py::test_it [passes alone] - reason 2" in output
    assert alone.ran == [each.test for each in _failures(5) for _ in range(2)]


@pytest.mark.parametrize("results", [(False,), (True, False)])
def test_one_that_fails_alone_makes_the_run_fail(
    results: tuple[bool, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert tell(_failures(2), _Alone(True, True, *results)) == 1
    output = capsys.readouterr().out
    assert "FAILED tests/test_1.py::test_it [fails alone too] - reason 1" in output
    assert "FAILED tests/test_0.py::test_it [passes alone] - reason 0" in output


def test_more_than_a_few_are_not_excused() -> None:
    assert tell(_failures(6), lambda _: True) == 1


def test_very_many_are_listed_without_another_run(capsys: pytest.CaptureFixture[str]) -> None:
    alone = _Alone()
    assert tell(_failures(_MANY), alone) == 1
    assert alone.ran == []
    assert capsys.readouterr().out.count("FAILED ") == _MANY


def test_a_run_that_was_cut_short_is_not_excused(capsys: pytest.CaptureFixture[str]) -> None:
    alone = _Alone()
    assert tell([*_failures(1), Failure("the run", "stopped", cut_short=True)], alone) == 1
    assert alone.ran == []
    assert capsys.readouterr().out.count("[not run again: the run was cut short]") == 2


def test_a_run_that_failed_without_a_test_that_did_is_not_excused() -> None:
    assert tell([], lambda _: True) == 1


def test_a_test_that_fails_twice_is_listed_once(tmp_path: Path) -> None:
    first, second = _failures(2)
    for each in (first, second, first):
        note(each, tmp_path / "failures")
    assert read(tmp_path / "failures") == [first, second]
    assert read(tmp_path / "none") == []
