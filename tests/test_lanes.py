"""Each test of a run has one lane, and a lane imports the files that it needs."""

from __future__ import annotations

from pathlib import Path

import pytest

from lanes import PHASES, is_alongside, needless

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
