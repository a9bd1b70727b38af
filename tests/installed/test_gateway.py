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

OF_EXTRAS = "uvloop cryptography jwt a2a starlette mcp cel pydantic pymavlink fastcrc can canopen cantools dronecan simplejpeg mujoco numpy rclpy zenoh mcap"

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
SECURE = """\
anonymous = false

[transports.asgi]
host = "0.0.0.0"

[transports.asgi.tls]
certificate = "gateway.pem"
key = "gateway.key"

[features]
configuration = true

[[backends]]
use = "sim"
tenant = "a"

[[certificates]]
name = "arm"
subject = "arm"
role = "operator"

[[jwt]]
issuer = "https://id.example"
audience = "robots"

[[hubs]]
id = "h1"
roles = ["operator"]
public_key = "none"
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
    assert sizes["rcp-gateway"] + sizes["rcp-client"] < 9e6  # bytes; 8.6 MB today
    # 43.7 MB today, half of it brought by Litestar: Faker 9.2, Pygments 4.6, PyYAML 2.9, itself 2.0.
    assert sum(sizes.values()) < 45e6


def test_the_demo_runs_and_says_what_more_there_is(programs: Path, tmp_path: Path) -> None:
    with demo(tmp_path, programs=programs) as running:
        assert remedies(running.banner) == OF_DEMO | {"fast"}
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
        "configuration",
        "ground-stations",
        "hubs",
        "jwt",
        "recorder",
        "replay",
        "ros2",
        "tracing",
        "triggers",
        "vda5050",
    }


def test_check_says_what_to_install(programs: Path, wanting: str) -> None:
    assert remedies(said(programs, "rcpd", "check", wanting, status=1)) == WANTED


def test_check_says_what_certificates_and_tokens_need(programs: Path, tmp_path: Path) -> None:
    file = tmp_path / "rcp.toml"
    file.write_text(SECURE)
    faults = said(programs, "rcpd", "check", str(file), status=1).splitlines()
    told = {one for fault in faults for one in re.findall(r":(\d+): .*gateway\[([\w-]+)\]", fault)}
    assert told == {
        ("6", "tls"),
        ("11", "configuration"),
        ("17", "tls"),
        ("22", "jwt"),
        ("26", "hubs"),
    }


def test_a_first_configuration_for_the_network_says_what_to_install(
    programs: Path, tmp_path: Path
) -> None:
    options = ("--yes", "--into", str(tmp_path), "--host")
    assert remedies(said(programs, "rcpd", "init", *options, "0.0.0.0", status=1)) == {"tls"}
    assert not list(tmp_path.iterdir())
    assert "rcp.toml" in said(programs, "rcpd", "init", *options, "127.0.0.1")


def test_commands_of_a_fleet_say_what_to_install(programs: Path, tmp_path: Path) -> None:
    command = ("rcpd", "fleet", "key", str(tmp_path / "fleet.key"))
    assert remedies(said(programs, *command, status=1)) == {"fleet"}


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
            url, before = listening(process)
            status = urlopen(url + "/rcp/v1/status").read().decode()
        finally:
            process.terminate()
            process.communicate(timeout=60)
    assert "event loop: asyncio" in before
    assert remedies(before) == WANTED | {"fast"}
    assert remedies(status) == WANTED
    body = msgspec.json.decode(status)["body"]
    assert {backend["state"] for backend in body["backends"]} == {"down"}


def listening(process: subprocess.Popen[bytes]) -> tuple[str, str]:
    """Wait for the gateway to say where it listens; return that, and all that it said."""
    assert process.stdout is not None
    out, end = b"", time.monotonic() + 60
    with selectors.DefaultSelector() as ready:
        ready.register(process.stdout, selectors.EVENT_READ)
        while not (found := re.search(rb"serving on (http://[\w.]+:\d+)", out)):
            assert ready.select(max(0.0, end - time.monotonic())), out.decode()
            chunk = process.stdout.read1(65536)  # type: ignore[attr-defined]
            assert chunk, out.decode()
            out += chunk
    return found[1].decode(), out.decode()
