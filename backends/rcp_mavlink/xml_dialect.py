"""A custom dialect: pymavlink generates a module from its XML, in a separate process."""

from __future__ import annotations

import importlib.util
import itertools
import re
import shutil
import subprocess
import sys
import tempfile
from importlib.resources import files
from pathlib import Path
from typing import Any

from rcp_kernel.errors import ConfigError

__all__ = ["module_of"]

_PATIENCE = 120.0  # s
_EXCERPT = 400  # characters of the generator's error output
_GENERATE = """
import sys
from pymavlink.generator import mavgen
xml, out = sys.argv[1:]
options = mavgen.Opts(out, wire_protocol="2.0", language="Python3", validate=True)
sys.exit(0 if mavgen.mavgen(options, [xml]) else "ERROR: duplicate names or ids")
"""
_WORD = re.compile(r"\W")
_made = itertools.count()


def module_of(path: Path) -> Any:
    """Generate and import the module of an XML file; takes seconds, so not on the event loop.

    Included files are searched beside it, then among pymavlink's own.

    :raises ConfigError: it does not exist, or is not a dialect.
    """
    if not path.is_file():
        raise ConfigError(f"`dialect`: no such file: {path}")
    with tempfile.TemporaryDirectory(prefix="rcp-dialect-") as folder:
        room = Path(folder)
        for own in files("pymavlink.dialects.v20").iterdir():
            if own.name.endswith(".xml"):
                (room / own.name).write_bytes(own.read_bytes())
        for beside in path.parent.glob("*.xml"):
            shutil.copyfile(beside, room / beside.name)
        out = room / f"rcp_dialect_{next(_made)}_{_WORD.sub('_', path.stem)}.py"
        _generate(path, room / path.name, out)
        return _imported(path, out)


def _generate(path: Path, copy: Path, out: Path) -> None:
    command = [sys.executable, "-c", _GENERATE, str(copy), str(out)]
    try:
        done = subprocess.run(  # noqa: S603 - the paths come from the configuration
            command, capture_output=True, text=True, timeout=_PATIENCE, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise ConfigError(f"`dialect`: reading {path} took longer than {_PATIENCE:g} s") from error
    if done.returncode != 0 or not out.is_file():
        why = _complaint(f"{done.stdout}\n{done.stderr}".replace(str(copy.parent) + "/", ""))
        raise ConfigError(f"`dialect`: {path} is not a dialect: {why}")


def _complaint(output: str) -> str:
    """Return the lines with the error, without the traceback."""
    lines = [line.strip() for line in output.splitlines()]
    lines = [line for line in lines if line and not line.startswith('File "')]
    wrong = [line for line in lines if "ERROR" in line.upper()]
    return "; ".join(wrong[-3:] or lines[-1:])[:_EXCERPT]


def _imported(path: Path, out: Path) -> Any:
    spec = importlib.util.spec_from_file_location(out.stem, out)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[out.stem] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[out.stem]
        raise ConfigError(f"`dialect`: {path} is not a dialect: {error}") from error
    return module
