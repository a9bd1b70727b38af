"""The distributions as people install them: wheels of this tree in virtual environments of their own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
_BUILD = 300.0  # s
_INSTALL = 600.0  # s


def wheels(folder: Path, *projects: str) -> list[Path]:
    """Build the wheels of folders of this tree, or take those that `RCP_WHEELS` names.

    The dashboard's pages take a minute and are no part of what is proved here.
    """
    built = os.environ.get("RCP_WHEELS")
    if built is None:
        _pip(Path(sys.executable), "wheel", "--no-deps", "-w", folder, *projects, within=_BUILD)
    found = {path.name.partition("-")[0]: path for path in Path(built or folder).glob("*.whl")}
    return [found[{"clients/python": "rcp_client", ".": "rcp_gateway"}[one]] for one in projects]


def venv(folder: Path, *built: Path) -> Path:
    """Make a virtual environment with wheels and what they need; return its folder of programs."""
    subprocess.run([sys.executable, "-m", "venv", folder], check=True, timeout=_INSTALL)
    programs = folder / "bin"
    constraints = ROOT / "constraints.txt"
    _pip(programs / "python", "install", "-c", constraints, *built, within=_INSTALL)
    return programs


def _pip(python: Path, *arguments: str | Path, within: float) -> None:
    """Run pip; without a registry there is no test, except where it is a must (`RCP_CI`)."""
    command = [
        python,
        "-m",
        "pip",
        arguments[0],
        "-q",
        "--disable-pip-version-check",
        *arguments[1:],
    ]
    environment = {"RCP_DASHBOARD": "off"} | os.environ
    done = subprocess.run(
        command,
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=within,
        check=False,
    )
    if done.returncode == 0:
        return
    offline = "NewConnectionError" in done.stderr or "No matching distribution" in done.stderr
    if offline and not os.environ.get("RCP_CI"):
        pytest.skip("pip reaches no registry")
    raise AssertionError(done.stderr)


def importable(programs: Path, *names: str) -> list[str]:
    """Return which of these modules an environment has."""
    code = (
        "import sys; from importlib.util import find_spec; print(*filter(find_spec, sys.argv[1:]))"
    )
    return said(programs, "python", "-c", code, *names).split()


def said(programs: Path, program: str, *arguments: str, status: int = 0, **environment: str) -> str:
    """Run a program of an environment and return all that it says, its exit code being `status`."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("RCP_")}
    done = subprocess.run(
        [programs / program, *arguments],
        cwd=programs,  # the tree is not importable from there
        env=kept | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == status, done.stdout
    return done.stdout
