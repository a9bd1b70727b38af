"""Every example configuration is good, and every example program does what it says."""

from __future__ import annotations

import hashlib
import re
import struct
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from PIL import Image

from certs import Authority
from docs.demo import BIN, Demo
from docs.pages import ROOT
from rcp_gateway.plugins import installed

EXAMPLES = ROOT / "examples"


def run(command: list[str], environment: dict[str, str] | None = None) -> str:
    done = subprocess.run(
        command, capture_output=True, check=False, text=True, timeout=120, cwd=ROOT, env=environment
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def example(name: str, *options: str, live: Demo) -> list[str]:
    path = EXAMPLES / f"{name}.py"
    out = run([sys.executable, str(path), "--url", live.url, *options], live.environment)
    return out.splitlines()


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_an_example_configuration_is_good(
    path: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for plugin in re.findall(r'^use = "(\w+)"', path.read_text(encoding="utf-8"), re.MULTILINE):
        if plugin not in installed("backends"):
            pytest.skip(f"{plugin} is another distribution's and not installed")
    for name in re.findall(r"\$\{(\w+)\}", path.read_text(encoding="utf-8")):
        key = f"{name.lower()}-0123456789"
        digest = hashlib.sha256(key.encode()).hexdigest()
        monkeypatch.setenv(name, digest if name.endswith(("SHA256", "SECRET")) else key)
    monkeypatch.setenv("RCP_HOME", str(tmp_path))
    (tmp_path / "tls").mkdir()
    ca = Authority(tmp_path / "tls", "CA")
    ca.server("gateway")
    assert ": good" in run([str(BIN / "rcpd"), "check", str(path)])


ELSEWHERE = {"moveit_arm": "backends/ros2/test_moveit_arm.py"}
"""Programs that need more than the demo, and the tests that run them."""


def test_every_program_is_proved() -> None:
    text = Path(__file__).read_text(encoding="utf-8")
    for path in EXAMPLES.glob("*.py"):
        if (test := ELSEWHERE.get(path.stem)) is not None:
            assert path.stem in (ROOT / "tests" / test).read_text(encoding="utf-8")
        else:
            assert f'example("{path.stem}"' in text


def test_tiles_of_an_invented_place_are_made_where_they_are_wanted(tmp_path: Path) -> None:
    made = tmp_path / "field.pmtiles"
    run([sys.executable, str(EXAMPLES / "tiles" / "make.py"), str(made), "--home", "47.4", "8.5"])
    head = made.read_bytes()[:127]
    assert head[:8] == b"PMTiles\x03"
    west, south, east, north = (n / 1e7 for n in struct.unpack("<4i", head[102:118]))
    assert west < 8.5 < east
    assert south < 47.4 < north


def test_poses_are_streamed_with_the_standard_library(live: Demo) -> None:
    lines = example("stream_pose", "--rate", "10", "--count", "3", live=live)
    assert len(lines) == 3
    assert all(re.fullmatch(r"\S+Z  x +-?[\d.]+ m  y +-?[\d.]+ m", line) for line in lines)


def test_poses_of_every_tenant_are_watched(live: Demo) -> None:
    lines = example("watch_pose", "--rate", "10", "--count", "12", live=live)
    assert len(lines) == 12
    # Which other robots tell a pose depends on what is installed.
    assert {line.split()[0] for line in lines} >= {
        "/tenant/alpha/sensor/pose",
        "/tenant/beta/sensor/pose",
    }


def test_any_mobile_robot_of_the_demo_patrols(live: Demo) -> None:
    lines = example("patrol", "/tenant/alpha", "--side", "0.5", live=live)
    assert sum(line.startswith("  there") for line in lines) == 4


def test_a_controller_steps_a_robot_with_physics(live: Demo) -> None:
    if find_spec("mujoco") is None:
        pytest.skip("the demo has robots with physics only with MuJoCo")
    *path, rate = example("step_rover", "--steps", "60", live=live)
    x, y = (float(part) for part in re.findall(r"-?[\d.]+", path[-1])[-2:])
    assert abs(x * x + (y - 1.0) ** 2 - 1.0) < 0.3  # a circle about (0, 1)
    assert re.fullmatch(r"60 steps, [\d.]+ a second, [\d.]+ s simulated", rate)


def test_a_stick_that_is_let_go_stops_the_robot(live: Demo) -> None:
    lines = example("drive", "--seconds", "1", "--tenant", "beta", live=live)
    speeds = [float(line.split()[0]) for line in lines if line.endswith("m/s")]
    assert speeds[0] > 0.1
    assert abs(speeds[-1]) < 0.05


def test_an_agent_that_knows_one_sentence_needs_few_calls_and_tokens(
    drone: Demo, tmp_path: Path
) -> None:
    photo = tmp_path / "photo.png"
    lines = example("agent", "--token", drone.key, "--picture", str(photo), live=drone)
    count = re.fullmatch(r"(\d+) calls, (\d+) tokens", lines[-1])
    assert count is not None
    assert int(count[1]) <= 12
    assert int(count[2]) <= 15_000
    seen = re.search(r"sees the box ([\d.]+) m in front", lines[-2])
    assert seen is not None
    assert 0.8 < float(seen[1]) < 1.5
    with Image.open(photo) as shown:
        picture = shown.convert("RGB")
    left, top = picture.width // 2 - 30, picture.height // 2 - 30
    middle = picture.crop((left, top, left + 60, top + 60))
    roof = [count for count, colour in middle.getcolors() or () if colour == (226, 160, 84)]
    assert sum(roof) > 60, "the box is in the middle of the drone's picture"
