"""Run the tests as `make test` does: `python tests [arguments of pytest]`.

What can runs side by side in several processes, a file's functions or a class in one of them; then
what is marked `paired`, two at a time; then, alone, what is marked `serial`. A single test, or what is
asked for with `-n0`, runs as ever.
No test runs in the process that counts: one that hangs where nothing can interrupt it ends its own process
alone, and is told as failed.

What failed is run again, alone, and told at the very end with its reason; see `verdict`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from backends.ros2.interfaces import SHARED
from failures import LISTED, Failure, read
from verdict import tell

_NONE = 5  # pytest's exit code when there is no such test
_STOPPED = 2
_FAILED = 1
_WORKERS = ("--dist", "loadscope", "--no-loadscope-reorder", "--max-worker-restart", "5")
_PHASES = (  # processes, and what they run
    ("auto", "not paired and not serial"),
    ("2", "paired and not serial"),
    ("1", "serial"),
)
_ALONE = (
    600  # s for one test, with all that comes before and after it: pytest may hang when it ends
)


def run(*arguments: str, listed: Path | None = None, within: float | None = None) -> int:
    """Run pytest to its end, or until it has taken too long; its exit code. What fails is listed in a file."""
    environment = {**os.environ, LISTED: str(listed or "")}
    command = [sys.executable, "-m", "pytest", *arguments]
    with subprocess.Popen(command, env=environment) as process:
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
    with tempfile.TemporaryDirectory() as folder:
        listed = Path(folder) / "failures"
        os.environ[SHARED] = folder
        result = _run_all(arguments, listed)
        return tell(read(listed), passes_alone) if result in (_FAILED, _STOPPED) else result


def _run_all(arguments: list[str], listed: Path) -> int:
    results: list[int] = []
    for processes, marked in _PHASES:
        result = run("-n", processes, *_WORKERS, "-m", marked, *arguments, listed=listed)
        if result not in (0, _FAILED, _NONE):
            return result
        results.append(result)
    return max((each for each in results if each != _NONE), default=_NONE)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
