"""Run the tests as `make test` does: `python tests [arguments of pytest]`.

What can runs side by side in several processes, a file's functions or a class in one of them; then,
alone, what is marked `calm`. A single test, or what is asked for with `-n0`, runs as ever.
"""

from __future__ import annotations

import subprocess
import sys

_NONE = 5  # pytest's exit code when there is no such test
_SPREAD = ("-n", "auto", "--dist", "loadscope", "--no-loadscope-reorder")


def run(*arguments: str) -> int:
    """Run pytest to its end; its exit code."""
    with subprocess.Popen([sys.executable, "-m", "pytest", *arguments]) as process:
        while True:
            try:
                return process.wait()
            except KeyboardInterrupt:  # pytest has it too, and ends with what it knows so far
                continue


def main(arguments: list[str]) -> int:
    """Run what is asked for; 0 if all of it passed."""
    if any("::" in each or each.startswith("-n") for each in arguments):
        return run(*arguments)
    spread = run(*_SPREAD, "-m", "not calm", *arguments)
    if spread not in (0, 1, _NONE):
        return spread
    calm = run("-m", "calm", *arguments)
    return spread if calm == _NONE else calm if spread == _NONE else max(spread, calm)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
