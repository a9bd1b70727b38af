"""`pip install rcp-gateway`: the simulated robots are served; what else is wanted names its extra."""

from __future__ import annotations

import os
import re
import selectors
import subprocess
import time
from pathlib import Path
from urllib.request import urlopen

import msgspec
import pytest

from docs.demo import demo
from installed.fresh import importable, said, venv, wheels

pytestmark = pytest.mark.timeout(900)

OF_EXTRAS = "a2a starlette mcp cel pydantic pymavlink fastcrc can canopen cantools dronecan simplejpeg mujoco numpy rclpy zenoh mcap"

ADAPTERS = """
[transports.asgi]
port = 0

[transports.zenoh]
tenant = "a"
gateway = "r1"
connect = ["tcp/127.0.0.1:7447"]

[plugins.a2a]

[plugins.mcp]
"""
BACKENDS = """
[[backends]]
use = "can"
tenant = "a"
buses.can0.interface = "virtual"

[[backends]]
use = "mavlink"
tenant = "b"
links = ["sim:copter"]

[[backends]]
use = "mujoco"
tenant = "c"
model = "rover"

[[backends]]
use = "fleet"
tenant = "d"
hub = "h1"
listen = ["tcp/127.0.0.1:7447"]
token = "key of the robots"
"""
OF_DEMO = {"a2a", "mcp", "can", "mavlink", "mujoco"}
CONDITION = """
[transports.asgi]

[[backends]]
use = "sim"
tenant = "a"

[roles.night]
allow = [{ operations = ["read"], paths = ["/sensor/**"], when = "time.hour < 6" }]
"""
WANTED = OF_DEMO | {"fleet", "zenoh"}


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("gateway")
    return venv(folder / "venv", *wheels(folder / "wheels", "clients/python", "."))


@pytest.fixture(scope="module")
def wanting(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Make a configuration that asks for what is in extras."""
    file = tmp_path_factory.mktemp("config") / "rcp.toml"
    file.write_text(ADAPTERS + BACKENDS)
    return str(file)


def remedies(text: str) -> set[str]:
    return set(re.findall(r"pip install 'rcp-gateway\[([\w-]+)\]'", text))


def test_it_brings_nothing_that_an_extra_is_for(programs: Path) -> None:
    assert importable(programs, *OF_EXTRAS.split()) == []


_SIZES = """
from importlib.metadata import distributions
from pathlib import Path
for one in distributions():
    files = [Path(str(file.locate())) for file in one.files or () if file.suffix != ".pyc"]
    print(one.name, sum(file.stat().st_size for file in files if file.is_file()))
"""


def test_the_core_is_small_and_so_is_what_it_brings(programs: Path) -> None:
    rows = (line.split() for line in said(programs, "python", "-c", _SIZES).splitlines())
    sizes = {name: int(size) for name, size in rows if name not in ("pip", "setuptools")}
    assert sizes["rcp-gateway"] + sizes["rcp-client"] < 15e6  # bytes; 11 MB today
    assert sum(sizes.values()) < 85e6  # 76 MB today: cryptography, uvloop, Faker


def test_the_demo_runs_and_says_what_more_there_is(programs: Path, tmp_path: Path) -> None:
    with demo(tmp_path, programs=programs) as running:
        assert remedies(running.banner) == OF_DEMO
        assert urlopen(running.url + "/healthz").status == 200
        output = said(programs, "rcpctl", "--url", running.url, "read", "/tenant/alpha/sensor/pose")
        assert "position" in output
        page = urlopen(running.url + "/").read().decode()
    if "RCP_WHEELS" in os.environ:  # those that are built for the tests alone have no pages
        assert 'id="app"' in page


def test_plugins_says_what_to_install(programs: Path) -> None:
    output = said(programs, "rcpd", "plugins")
    unavailable = {line for line in output.splitlines() if "unavailable" in line}
    assert remedies("\n".join(unavailable)) == WANTED | {
        "ground-stations",
        "recorder",
        "replay",
        "tracing",
        "triggers",
        "vda5050",
    }


def test_check_says_what_to_install(programs: Path, wanting: str) -> None:
    assert remedies(said(programs, "rcpd", "check", wanting, status=1)) == WANTED


def test_check_says_what_a_condition_needs(programs: Path, tmp_path: Path) -> None:
    file = tmp_path / "rcp.toml"
    file.write_text(CONDITION)
    assert remedies(said(programs, "rcpd", "check", str(file), status=1)) == {"conditions"}


def test_mcp_on_stdio_says_what_to_install(programs: Path) -> None:
    assert remedies(said(programs, "rcpd", "mcp", status=1)) == {"mcp"}


def test_serve_goes_on_without_and_says_what_to_install(programs: Path, wanting: str) -> None:
    command = [programs / "rcpd", "serve", wanting]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:
        try:
            url = listening(process)
            status = urlopen(url + "/rcp/v1/status").read().decode()
        finally:
            process.terminate()
            process.communicate(timeout=60)
    assert remedies(status) == WANTED
    body = msgspec.json.decode(status)["body"]
    assert {backend["state"] for backend in body["backends"]} == {"down"}


def listening(process: subprocess.Popen[bytes]) -> str:
    """Wait for the gateway to say where it listens."""
    assert process.stdout is not None
    out, end = b"", time.monotonic() + 60
    with selectors.DefaultSelector() as ready:
        ready.register(process.stdout, selectors.EVENT_READ)
        while not (found := re.search(rb"http://[\w.]+:\d+", out)):
            assert ready.select(max(0.0, end - time.monotonic())), out.decode()
            chunk = process.stdout.read1(65536)  # type: ignore[attr-defined]
            assert chunk, out.decode()
            out += chunk
    return found[0].decode()
