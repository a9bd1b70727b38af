"""Foxglove's own client, run by node."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from node import node, npm_packages

__all__ = ["PATIENCE", "driven", "driver"]

SCRIPT = Path(__file__).parents[2] / "npm" / "foxglove" / "drive.mjs"
PATIENCE = 120.0  # s that a whole drive may take


@contextmanager
def driver(folder: Path, **given: Any) -> Generator[subprocess.Popen[str]]:
    """Run the client while entered."""
    packages = npm_packages("foxglove")
    if not (folder / "node_modules").exists():
        (folder / "node_modules").symlink_to(packages / "node_modules")
    shutil.copy(SCRIPT, folder)
    command = [node(), "--no-warnings", str(folder / SCRIPT.name)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as process:
        try:
            assert process.stdin is not None
            process.stdin.write(json.dumps(given))
            process.stdin.close()
            yield process
        finally:
            process.kill()


def driven(folder: Path, **given: Any) -> dict[str, Any]:
    """Run the client to its end; return its report."""
    with driver(folder, **given) as process:
        return report(process)


def report(process: subprocess.Popen[str]) -> dict[str, Any]:
    """Wait for the client's end; return its report."""
    process.stdin = None
    out, wrong = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, wrong
    return json.loads(out)
