"""Tests that hang, crash or are stopped in a run of their own, and what `python tests` makes of them."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from verdict import HEADING

TESTS = Path(__file__).parent
BOUND = 240.0  # s for a run
OWN = {k: v for k, v in os.environ.items() if not k.startswith(("PYTEST_", "RCP_"))}
INI = f"""
[pytest]
addopts = --import-mode=importlib -p no:cacheprovider -p xdist
pythonpath = {TESTS}
markers =
    serial
    paired
faulthandler_timeout = 4
faulthandler_exit_on_timeout = true
"""
CONFTEST = f"""
import importlib.util, sys
spec = importlib.util.spec_from_file_location("shared", {str(TESTS / "conftest.py")!r})
shared = importlib.util.module_from_spec(spec)
spec.loader.exec_module(shared)
shared._REST = 4
globals().update({{k: v for k, v in vars(shared).items() if k.startswith("pytest_")}})

def pytest_xdist_auto_num_workers(config):
    return 2  # one that goes on while the other hangs: each takes seconds to start

def pytest_runtest_logstart(nodeid):
    shared.pytest_runtest_logstart(nodeid)
    if shared._leading and "takes_long" in nodeid:
        with open("ready", "w"): pass
"""
HANGS = """
import ctypes, pytest
from pathlib import Path

def first(name):
    there = Path(name).exists()
    Path(name).touch()
    return not there

def hang():
    ctypes.PyDLL(None).pause()  # holds the GIL, and no signal is handled

@pytest.fixture
def kept():
    yield
    if first("teardown"):
        hang()
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    (tmp_path / "pytest.ini").write_text(INI)
    (tmp_path / "conftest.py").write_text(CONFTEST)
    return tmp_path


def start(project: Path, **tests: str) -> subprocess.Popen[str]:
    for name, text in tests.items():
        (project / f"test_{name}.py").write_text(HANGS + text)
    return subprocess.Popen(
        [sys.executable, TESTS],
        cwd=project,
        env=OWN | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def verdict(process: subprocess.Popen[str]) -> tuple[int, str]:
    with process:
        try:
            output, _ = process.communicate(timeout=BOUND)
        finally:
            process.kill()
    return process.returncode, output


def test_a_run_goes_on_after_tests_that_hang_and_excuses_those_that_pass_alone(
    project: Path,
) -> None:
    code, told = verdict(
        start(
            project,
            parallel="""
def test_before(): pass
def test_hangs():
    if first("call"): hang()
def test_after(): Path("after").touch()
""",
            serial="""
@pytest.mark.serial
def test_fails_and_hangs_in_its_teardown(kept): assert Path("teardown").exists()
@pytest.mark.serial
def test_last(): Path("last").touch()
""",
        )
    )
    assert "replacing crashed worker" in told
    assert "Current thread" in told or "most recent call first" in told  # where it hung
    assert (project / "after").exists()
    assert (project / "last").exists()
    _, _, end = told.rpartition(HEADING)
    assert end.startswith(": 2\n"), told
    for name in ("parallel.py::test_hangs", "serial.py::test_fails_and_hangs_in_its_teardown"):
        assert f"FAILED test_{name} [passes alone]" in end, told
    assert code == 0


def test_a_test_that_always_ends_its_process_fails_the_run_and_runs_once_in_it(
    project: Path,
) -> None:
    code, told = verdict(
        start(
            project,
            dies="""
def test_dies():
    with Path("times").open("a") as times: times.write("x")
    import os; os._exit(3)
def test_after(): Path("after").touch()
""",
        )
    )
    assert "FAILED test_dies.py::test_dies [fails alone too]" in told, told
    assert "worker 'gw" in told.rpartition(HEADING)[2]
    assert (project / "times").read_text() == "xx"  # side by side, and once alone
    assert (project / "after").exists()
    assert code == 1


def test_a_run_that_is_stopped_tells_what_failed_and_what_was_under_way(project: Path) -> None:
    os.mkfifo(project / "ready")
    ready = os.open(project / "ready", os.O_RDONLY | os.O_NONBLOCK)
    process = start(
        project,
        stopped="""
def test_fails(): assert not "as it is"
def test_takes_long():
    import time
    time.sleep(300)
""",
    )
    seen = select.poll()
    seen.register(ready)
    under_way = seen.poll(BOUND * 1000)  # the other end was opened, and closed
    os.close(ready)
    os.killpg(process.pid, signal.SIGINT)
    code, told = verdict(process)
    assert under_way, told
    _, _, end = told.rpartition(HEADING)
    cut = "[not run again: the run was cut short]"
    assert f"FAILED test_stopped.py::test_fails {cut} - AssertionError" in end, told
    assert f"FAILED test_stopped.py::test_takes_long {cut} - was under way" in end, told
    assert f"FAILED the run {cut}" in end, told
    assert code == 1


def test_a_mark_that_its_file_does_not_spell_out_fails_the_run(project: Path) -> None:
    code, told = verdict(
        start(
            project,
            alias="""
quick = getattr(pytest.mark, "serial")
class Base:
    pytestmark = quick
class TestIt(Base):
    def test_it(self): pass
""",
        )
    )
    assert "test_it is marked, but its file does not say `pytest.mark.serial`" in told, told
    assert "FAILED test_alias.py" in told.rpartition(HEADING)[2], told
    assert code == 1


def test_a_lane_in_which_there_is_nothing_fails_a_run_of_all_tests(project: Path) -> None:
    code, told = verdict(start(project, serial="@pytest.mark.serial\ndef test_it(): pass\n"))
    assert "FAILED tests that are not alongside" in told.rpartition(HEADING)[2], told
    assert "none was found" in told
    assert code == 1
