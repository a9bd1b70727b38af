"""The first robot of each kind drives by the commands of the page."""

from __future__ import annotations

import os
import re
import subprocess
import time
from importlib.util import find_spec
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest

from docs.blocks import BLOCKS
from docs.demo import BIN
from serving import serving

_READY = 120  # s that a robot may take on a busy machine
_BLOCKS = {
    found[1]: block.text
    for block in BLOCKS
    if block.page == "docs/first-robot.md"
    and (found := re.search(r"--robot-kind (\w+)", block.text))
}
_MODULES = {"mujoco": "mujoco", "can": "can"}


def run(line: str, folder: Path, **environment: str) -> None:
    kept = {name: value for name, value in os.environ.items() if not name.startswith("RCP_")}
    done = subprocess.run(
        ["bash", "-c", line],
        cwd=folder,
        env={**kept, **environment, "PATH": f"{BIN}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
        timeout=_READY,
    )
    assert done.returncode == 0, f"{line}: {done.stdout}{done.stderr}"


def wait_until_ready(url: str) -> None:
    end = time.monotonic() + _READY
    while True:
        try:
            urlopen(f"{url}/readyz", timeout=40).close()
        except HTTPError as error:
            assert error.code == 503  # noqa: PT017 - until the robot is connected
            assert time.monotonic() < end, "the robot does not connect"
            time.sleep(0.1)
        else:
            return


def test_each_kind_that_init_knows_has_its_section() -> None:
    assert set(_BLOCKS) == {"sim", "mujoco", "mavlink", "can", "ros2"}


# `sim` is in tests/rcpd/test_init.py; the drone of the demo is flown by tests/docs/test_tour.py.
@pytest.mark.parametrize("kind", ["mujoco", "can"])
def test_a_first_robot_moves(kind: str, tmp_path: Path) -> None:
    if find_spec(_MODULES[kind]) is None:
        pytest.skip(f"the extra {kind} is not installed")
    lines = [line for line in _BLOCKS[kind].splitlines() if line.startswith("rcp")]
    run(lines[0], tmp_path)
    file = tmp_path / "rcp.toml"
    text = file.read_text().replace("port = 8080", "port = 0")
    with serving(file, text) as url:
        key = (tmp_path / "operator.key").read_text().strip()
        wait_until_ready(url)
        for line in lines[1:]:
            run(line, tmp_path, RCP_URL=url, RCP_TOKEN=key)
