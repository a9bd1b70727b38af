"""Run the tests as `make test` does: `python tests [arguments of pytest]`.

What can runs side by side in several processes, a file's functions or a class in one of them; then
what is marked `paired`, two at a time, and beside them, in two more, what only computes; then, alone,
what is marked `serial`: see `lanes`. A single test, or what is asked for with `-n0`, runs as ever.
No test runs in the process that counts: one that hangs where nothing can interrupt it ends its own process
alone, and is told as failed.

What failed is run again, alone, and told at the very end with its reason; see `verdict`.
"""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

from backends.ros2.interfaces import SHARED
from failures import LISTED, Failure, note, read
from lanes import PHASES, Lane, chooses
from verdict import tell

_NONE = 5  # pytest's exit code when there is no such test
_STOPPED = 2
_FAILED = 1
_WORKERS = ("--dist", "loadscope", "--no-loadscope-reorder", "--max-worker-restart", "5")
_ALONE = (
    600  # s for one test, with all that comes before and after it: pytest may hang when it ends
)


def run(*arguments: str, within: float | None = None) -> int:
    """Run pytest to its end, or until it has taken too long; its exit code."""
    with _started(*arguments) as process:
        return _ended(process, within)


def _started(
    *arguments: str, listed: Path | None = None, told: Any = None
) -> subprocess.Popen[Any]:
    """Start pytest: what fails is listed in one file, what it tells goes to another."""
    environment = {**os.environ, LISTED: str(listed or "")}
    command = [sys.executable, "-m", "pytest", *arguments]
    return subprocess.Popen(command, env=environment, stdout=told, stderr=told)


def _ended(process: subprocess.Popen[Any], within: float | None = None) -> int:
    while True:
        try:
            return process.wait(within)
        except subprocess.TimeoutExpired:
            process.kill()
        except KeyboardInterrupt:  # pytest has it too, and ends with what it knows so far
            continue


def passes_alone(failure: Failure) -> bool:
    """Run a test by itself."""
    return run("-n0", "-q", "--no-header", "--tb=short", failure.test, within=_ALONE) == 0


def main(arguments: list[str]) -> int:
    """Run what is asked for; 0 if all of it passed, or if nothing but a busy machine spoke against it."""
    if any("::" in each or each.startswith("-n") for each in arguments):
        return run(*arguments)
    with TemporaryDirectory() as folder:
        listed = Path(folder) / "failures"
        os.environ[SHARED] = folder
        result = _run_all(arguments, listed)
        return tell(read(listed), passes_alone) if result in (_FAILED, _STOPPED) else result


def _run_all(arguments: list[str], listed: Path) -> int:
    results: list[int] = []
    for phase in PHASES:
        lanes = [lane for lane in phase if lane.has_tests(arguments)]
        results += _judged(lanes, _run_lanes(lanes, arguments, listed), arguments, listed)
        cut = next((each for each in results if each not in (0, _FAILED, _NONE)), None)
        if cut is not None:
            return cut
    return max((each for each in results if each != _NONE), default=_NONE)


def _judged(lanes: list[Lane], results: list[int], arguments: list[str], listed: Path) -> list[int]:
    """Make a failure of a lane that found nothing to run though all tests were asked for."""
    if chooses(arguments) or os.environ.get("PYTEST_ADDOPTS"):
        return results
    for lane, result in zip(lanes, results, strict=True):
        if result == _NONE:
            note(Failure(f"tests that are {lane.tests}", "none was found", cut_short=True), listed)
    return [_FAILED if result == _NONE else result for result in results]


def _run_lanes(lanes: list[Lane], arguments: list[str], listed: Path) -> list[int]:
    """Run lanes at the same time: the first one tells as it goes, the others when all have ended."""
    with ExitStack() as stack:
        told = [
            None if lane is lanes[0] else stack.enter_context(TemporaryFile()) for lane in lanes
        ]
        processes = [
            stack.enter_context(
                _started(
                    *("-n", lane.processes, *_WORKERS, "-m", lane.tests, *arguments),
                    listed=listed,
                    told=file,
                )
            )
            for lane, file in zip(lanes, told, strict=True)
        ]
        results = [_ended(process) for process in processes]
        for file in filter(None, told):
            file.seek(0)
            sys.stdout.write(file.read().decode(errors="replace"))
            sys.stdout.flush()
        return results


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
