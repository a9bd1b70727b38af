"""The script of CI in a project of its own, whose steps are stubs: what it makes of steps that fail or never end."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

RUN = Path(__file__).parent.parent / ".ci" / "run"
STUBS = """
tools() { :; }
wheel() { :; }
tests() { :; }
hygiene() { :; }
example() { :; }
"""
"""In place of what installs or takes long: the rest is the script's own, and calls stubs of programs."""
BOUND = 60.0  # s for a run
PLACE = Path("/work") / "elsewhere"


@pytest.fixture
def project(tmp_path: Path) -> Path:
    programs = tmp_path / ".venv" / "bin"
    programs.mkdir(parents=True)
    for name in ("python", "ruff", "lint-imports", "pyright"):
        program(programs / name, "exit 0")
    (tmp_path / ".ci").mkdir()
    shutil.copy(RUN, tmp_path / ".ci" / "run")
    program(tmp_path / ".ci" / "container", "exit 0")
    (tmp_path / "Makefile").write_text(".venv/.test:\n\ttouch $@\nsite:\n")
    return tmp_path


def program(file: Path, text: str) -> None:
    file.write_text(f"#!/bin/sh\n{text}\n")
    file.chmod(0o755)


def started(project: Path, *lines: str) -> subprocess.Popen[str]:
    """Start lines in the script's own shell."""
    return subprocess.Popen(
        ["bash", "-c", "\n".join(("source .ci/run", *lines))],
        cwd=project,
        env=os.environ | {"HOME": str(project)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def ran(project: Path, *lines: str) -> tuple[int, str]:
    with started(project, *lines) as process:
        try:
            told, _ = process.communicate(timeout=BOUND)
        finally:
            process.kill()
    return process.returncode, told


def test_a_run_in_which_every_step_passes_passes(project: Path) -> None:
    code, told = ran(project, STUBS, "main")
    assert told.endswith("=== passed\n"), told
    assert code == 0


def test_steps_beside_the_tests_run_where_no_priority_can_be_changed(project: Path) -> None:
    code, told = ran(project, STUBS, "renice() { return 1; }", "export -f renice", "main")
    assert told.endswith("=== passed\n"), told
    assert "  types\n" in told
    assert code == 0


@pytest.mark.parametrize(
    ("end", "failed"), [("exit 0", "maintenance turtle"), ("exit 3", "examples maintenance turtle")]
)
def test_steps_that_were_never_run_make_the_run_fail(project: Path, end: str, failed: str) -> None:
    code, told = ran(project, STUBS, f"examples() {{ {end}; }}", "main")
    assert told.endswith(f"=== failed: {failed}\n"), told
    assert code == 1


def test_a_step_that_nobody_expects_makes_the_run_fail(project: Path) -> None:
    code, told = ran(project, STUBS, "examples() { aside maintenance :; aside new :; }", "main")
    assert told.endswith("=== failed: turtle new\n"), told
    assert code == 1


@pytest.mark.parametrize("sleeps", ["exec sleep 300", "trap '' TERM; sleep 300; sleep 300"])
def test_a_step_that_hangs_ends_the_run_with_its_name(project: Path, sleeps: str) -> None:
    program(project / ".venv" / "bin" / "pyright", sleeps)
    code, told = ran(project, STUBS, "bound=0.2 grace=0.2", "main")
    assert "=== types FAILED" in told, told
    assert "not done within 0.2" in told
    assert told.endswith("=== failed: types\n"), told
    assert code == 1


def test_a_run_that_is_ended_leaves_no_step_behind(project: Path) -> None:
    os.mkfifo(project / "alive")
    program(project / ".venv" / "bin" / "pyright", "exec >alive; echo begun; exec sleep 300")
    with started(project, STUBS, "main") as process, (project / "alive").open() as alive:
        assert alive.readline() == "begun\n"
        process.terminate()
        assert process.wait(BOUND) == 130
        assert alive.read() == ""  # whoever could have written to it has ended


def test_a_failed_installation_fails_although_an_earlier_one_passed(project: Path) -> None:
    (project / ".venv" / ".test").touch()
    (project / "Makefile").write_text(".venv/.test: always\n\tfalse\nalways:\n")
    code, told = ran(project, STUBS, "main")
    assert "=== install FAILED" in told, told
    assert code == 1


def test_no_tracked_file_names_a_place_of_one_machine(project: Path) -> None:
    """However many files there are: a search in several parts has several results."""
    folder = project / ("long" * 50)
    folder.mkdir()
    for number in range(700):
        (folder / f"{number}").touch()
    (project / "constraints.txt").write_text("attrs==1.0\n")
    (project / "a").write_text("nothing\n")
    subprocess.run(["git", "init", "-q"], cwd=project, check=True)
    subprocess.run(["git", "add", "a", "constraints.txt", folder.name], cwd=project, check=True)
    assert ran(project, "hygiene") == (0, "")
    (project / "a").write_text(f"in {PLACE}\n")
    code, told = ran(project, "hygiene")
    assert f"a:1:in {PLACE}" in told
    assert code == 1
    shutil.rmtree(project / ".git")
    assert ran(project, "hygiene")[0] != 0
