"""What every test needs."""

from __future__ import annotations

import faulthandler
import gc
import logging
import os
import signal
from collections import Counter
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import psutil
import pytest
import structlog
from _pytest.faulthandler import fault_handler_stderr_fd_key
from hypothesis import HealthCheck, settings

from ahead import AHEAD, machine_time  # the first of ours, so that nobody keeps another clock
from failures import LISTED, Failure, failure, keep, note
from lanes import is_alongside, needless, unwritten
from pairs import left_out
from rcp_gateway.testing import SteppedClock, SteppedLoop
from rcp_kernel.clock import SYSTEM_CLOCK, Clock
from scheduling import PROCESSES, Scheduling, turn

_under_way: set[str] = set()
_REST = 120  # s that a test that failed may take to clean up
_MEMORY = 2**31  # bytes that a process and what its tests start may need
_LINE = 4000  # characters of a line in a report: errors are told in full, maps and pictures are not
_PHASES = ("setup", "call", "teardown")
_listed = os.environ.get(LISTED)
_leading = "PYTEST_XDIST_WORKER" not in os.environ

# How long an example takes is the machine's affair: no test is timed. CI tries the same each time.
settings.register_profile(
    "untimed",
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    derandomize=not {"CI", "RCP_CI"}.isdisjoint(os.environ),
)
settings.load_profile("untimed")

# Where the tests are started in the background, Ctrl-C is ignored, and would be by all they start.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="module")
def logging_of_a_file() -> Generator[None]:
    """Let no file's gateways set the log level of another's."""
    with _own_logging():
        yield


@pytest.fixture(autouse=True)
def logging_of_a_test() -> Generator[None]:
    """Let no test's gateway set the log level of another's."""
    with _own_logging():
        yield


@pytest.fixture(autouse=True, scope="module")
def garbage_of_a_file() -> Generator[None]:
    """Let no test look for garbage among what earlier files have left for good: it is most of the objects."""
    yield
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True, scope="session")
def garbage_of_a_run() -> Generator[None]:
    """Look once at what has become garbage since: what it has left open is told with the last test."""
    yield
    gc.unfreeze()
    gc.collect()
    gc.freeze()  # nothing is left to be looked at when pytest ends


@contextmanager
def _own_logging() -> Generator[None]:
    known = structlog.get_config() if structlog.is_configured() else None
    root = logging.getLogger()
    level, handlers = root.level, list(root.handlers)
    yield
    if known is None:
        structlog.reset_defaults()  # a gateway of the kit configures what nobody has
    else:
        structlog.configure(**known)
    root.setLevel(level)
    for handler in [one for one in root.handlers if one not in handlers]:
        root.removeHandler(handler)


@pytest.fixture
def stepped() -> SteppedClock:
    """The time of the gateway's rules and of the test's event loop, which the test puts forward."""
    return SteppedClock()


@pytest.fixture
def boot(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Return a function that sets the monotonic clock to that of a machine that has just booted.

    The event loop's too, but for uvloop's; a `stepped` clock goes on from there.
    """

    def booted() -> None:
        monkeypatch.setattr(AHEAD, "booted", machine_time() + AHEAD.seconds - 0.05)

    return booted


@pytest.fixture
def gateway_clock(request: pytest.FixtureRequest) -> Clock:
    """The clock of the gateways that fixtures run: `stepped` where a test asks for it."""
    if "stepped" not in request.fixturenames:
        return SYSTEM_CLOCK
    clock: SteppedClock = request.getfixturevalue("stepped")
    return clock.clock


@pytest.fixture
def anyio_backend(request: pytest.FixtureRequest) -> tuple[str, dict[str, Any]]:
    """Run on asyncio, the kernel's event loop: by the time of `stepped` where a test asks for it."""
    if "stepped" not in request.fixturenames:
        return "asyncio", {}
    clock: SteppedClock = request.getfixturevalue("stepped")
    return "asyncio", {"loop_factory": partial(SteppedLoop, clock)}


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Take several processes a core, as far as memory goes: tests wait more than they compute."""
    fit = psutil.virtual_memory().available // _MEMORY
    return max(1, min(PROCESSES * (psutil.cpu_count() or 1), fit))


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Scheduling:
    """Keep the cores evenly busy."""
    return Scheduling(config, log)


def pytest_collection_finish() -> None:
    """Keep what is there for good out of garbage collections: five thousand tests and their modules."""
    gc.collect()
    gc.freeze()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no file of which a phase runs nothing: it takes a process half as long as its tests."""
    return True if needless(collection_path, config.option.markexpr) else None


@pytest.hookimpl(wrapper=True)
def pytest_pycollect_makeitem(collector: pytest.Module | pytest.Class) -> Generator[None, Any, Any]:
    """Refuse a file of which a lane could not know that it has tests of its own."""
    made = yield
    for item in made if isinstance(made, list) else ():
        for mark in unwritten(item):
            message = f"{item.name} is marked, but its file does not say `pytest.mark.{mark}`: no lane runs it"
            raise collector.CollectError(message)
    return made


def pytest_itemcollected(item: pytest.Item) -> None:
    """Mark what runs in the lane beside the `paired` tests."""
    if is_alongside(item.path):
        item.add_marker(pytest.mark.alongside)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with what takes longest; leave out what repeats others, unless it is asked for by its name."""
    items.sort(key=lambda item: turn(item.nodeid))
    if any("::" in each for each in config.args):
        return
    repeated = [item for item in items if left_out(item)]
    if repeated:
        config.hook.pytest_deselected(items=repeated)
        items[:] = [item for item in items if item not in repeated]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Cut lines that nobody could read."""
    report = yield
    keep(item, report)
    for entry in getattr(getattr(report.longrepr, "reprtraceback", None), "reprentries", ()):
        entry.lines = [line if len(line) <= _LINE else line[:_LINE] + " …" for line in entry.lines]
    return report


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """List what fails, for whoever asked for a list; a process that ended under a test is told here alone."""
    if report.when not in _PHASES:
        _under_way.discard(report.nodeid)
    if report.failed and _listed and _leading:
        note(failure(report), Path(_listed))


def pytest_collectreport(report: pytest.CollectReport) -> None:
    """List what cannot be imported too."""
    if report.failed and _listed and _leading:
        note(failure(report), Path(_listed))


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """List that tests were left out, and which were cut off: no other can speak for them."""
    if not (_listed and _leading):
        return
    stopped = exitstatus == pytest.ExitCode.INTERRUPTED
    for nodeid in sorted(_under_way) if stopped else ():
        note(Failure(nodeid, "was under way when the tests were stopped"), Path(_listed))
    if stopped or session.shouldfail or session.shouldstop:
        note(Failure("the run", "it was cut short", cut_short=True), Path(_listed))


@pytest.hookimpl(trylast=True)
def pytest_exception_interact(node: pytest.Item | pytest.Collector) -> None:
    """Bound what is left of a test that failed: pytest, and its plugin, have just dropped their bounds."""
    if isinstance(node, pytest.Item) and not node.config.getoption("usepdb"):
        stderr = node.config.stash[fault_handler_stderr_fd_key]
        faulthandler.dump_traceback_later(_REST, file=stderr, exit=True)


def pytest_runtest_logstart(nodeid: str) -> None:
    """Note what begins, in whichever process."""
    _under_way.add(nodeid)


def pytest_runtest_logfinish(nodeid: str) -> None:
    """Note what has ended."""
    _under_way.discard(nodeid)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Say where the tests' time went, by folder, and what was cut off when they were stopped."""
    seconds: Counter[str] = Counter()
    tests: Counter[str] = Counter()
    for reports in terminalreporter.stats.values():
        for report in reports:
            if isinstance(report, pytest.TestReport):
                folder = "/".join(report.nodeid.partition("::")[0].split("/")[:-1][:3])
                seconds[folder] += report.duration
                tests[folder] += report.when == "call"
    if len(seconds) > 1:
        terminalreporter.section("seconds of tests by folder")
        for folder, spent in seconds.most_common():
            terminalreporter.line(f"{spent:7.1f}  {tests[folder]:5} tests  {folder}")
    for nodeid in sorted(_under_way):
        terminalreporter.line(f"ERROR {nodeid} - was under way when the tests were stopped")
