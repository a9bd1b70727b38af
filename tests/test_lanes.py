"""Each test of a run has one lane, and a lane imports the files that it needs."""

from __future__ import annotations

from pathlib import Path

import pytest

from lanes import PHASES, Lane, chooses, is_alongside, needless

TESTS = Path(__file__).parent
REST, PAIRED, BESIDE, SERIAL = (lane for lane in sum(PHASES, ()))
MARKED = "@pytest.mark.{}\ndef test_it(): pass\n"


@pytest.mark.parametrize(
    ("mark", "lanes"),
    [("paired", {PAIRED, REST}), ("serial", {SERIAL, REST}), ("anyio", {REST})],
)
def test_a_file_is_imported_where_it_may_have_tests(
    tmp_path: Path, mark: str, lanes: set[object]
) -> None:
    file = tmp_path / "test_it.py"
    file.write_text(MARKED.format(mark))
    assert {each for each in sum(PHASES, ()) if each.has_tests([str(file)])} == lanes


def test_what_runs_alongside_is_not_imported_by_others() -> None:
    file = TESTS / "conformance" / "test_http.py"
    assert is_alongside(file)
    assert not is_alongside(TESTS / "transports" / "test_http.py")
    assert [each for each in sum(PHASES, ()) if not needless(file, each.tests)] == [BESIDE]


def test_no_folder_is_searched_but_for_files_of_tests(tmp_path: Path) -> None:
    (tmp_path / "helper.py").write_text(MARKED.format("paired"))
    assert not any(each.has_tests([str(tmp_path)]) for each in sum(PHASES, ()))


def lanes(*arguments: str) -> set[Lane]:
    return {each for each in sum(PHASES, ()) if each.has_tests(arguments)}


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for mark in ("paired", "serial", "anyio"):
        folder = tmp_path / "tests" / mark
        folder.mkdir(parents=True)
        (folder / "test_it.py").write_text(MARKED.format(mark))
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    "arguments",
    [
        "",
        "--ignore tests/paired",
        "--ignore tests/anyio",
        "--ignore=tests/anyio -k it",
        "--deselect tests/serial -q",
        "--junit-xml tests/anyio",
    ],
)
@pytest.mark.usefixtures("folders")
def test_the_value_of_an_option_is_not_where_tests_are(arguments: str) -> None:
    assert lanes(*arguments.split()) == {REST, PAIRED, SERIAL}


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        ("tests/anyio", {REST}),
        ("-xvs tests/anyio --tb=short", {REST}),
        ("--tb=short tests/paired", {REST, PAIRED}),
        ("-k it tests/paired", {REST, PAIRED}),
        ("-x tests/paired tests/serial", {REST, PAIRED, SERIAL}),
        ("--maxfail 1 tests/serial", {REST, SERIAL}),
        ("--lf tests/paired tests/anyio", {REST, PAIRED}),
        ("--lf tests/anyio", {REST, PAIRED, SERIAL}),  # the value of an option, for all we know
    ],
)
@pytest.mark.usefixtures("folders")
def test_paths_among_options_are_where_tests_are(arguments: str, found: set[Lane]) -> None:
    assert lanes(*arguments.split()) == found


@pytest.mark.parametrize(
    ("arguments", "may"),
    [
        ("", False),
        ("--durations=10 -rfE", False),
        ("-x -q --tb=short", False),
        ("tests/kernel", True),
        ("-k it", True),
        ("--lf", True),
        ("--ignore=tests/browser", True),
    ],
)
def test_only_a_run_of_all_tests_has_some_for_each_lane(arguments: str, may: bool) -> None:  # noqa: FBT001
    assert chooses(arguments.split()) is may
