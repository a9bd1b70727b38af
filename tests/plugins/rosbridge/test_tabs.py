"""Official clients in two tabs each, before and after the gateway was killed."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from configuration import backend, table
from node import node, npm_packages
from plugins.foxglove.driver import PATIENCE, driver, report
from ports import free_port
from serving import ROVER

KEY = "operator-operator"
TEXT = (
    ROVER
    + backend("offered", use="clients")
    + table("plugins.foxglove", token_in_url=True)
    + table("plugins.rosbridge")
)


@contextmanager
def roslib(folder: Path, url: str) -> Generator[subprocess.Popen[str]]:
    """Run the tabs while entered."""
    folder.mkdir()
    (folder / "node_modules").symlink_to(npm_packages("rosbridge") / "node_modules")
    page = folder / "tabs.mjs"
    page.write_text((Path(__file__).parent / page.name).read_text())
    command = [node(), "--no-warnings", page, url, KEY]
    with subprocess.Popen(command, text=True, stdout=-1, stderr=-1) as process:
        try:
            yield process
        finally:
            process.kill()


def started(config: Path) -> subprocess.Popen[str]:
    """Start a gateway, and wait until it serves."""
    rcpd = Path(sys.executable).with_name("rcpd")
    process = subprocess.Popen([rcpd, "serve", config], stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    assert any("serving on " in line for line in process.stderr)
    return process


def test_clients_are_back_after_the_gateway_was_killed(tmp_path: Path) -> None:
    port = free_port()
    config = tmp_path / "rcp.toml"
    config.write_text(TEXT.replace("port = 0", f"port = {port}"))
    url = f"ws://127.0.0.1:{port}"
    watch = {
        "url": f"{url}/foxglove/alpha?token={KEY}",
        "subprotocol": "foxglove.sdk.v1",
        "robot": "reconnect",
        "topics": ["/sensor/pose"],
    }
    gateways = [started(config)]
    try:
        with (
            roslib(tmp_path / "tabs", f"{url}/rosbridge") as tabs,
            driver(tmp_path, **watch) as viewer,
            driver(tmp_path, **watch) as second,
        ):
            assert tabs.stdout is not None
            ready = tabs.stdout.readline()
            assert ready == "ready\n", tabs.stderr and tabs.stderr.read()
            for one in (viewer, second):
                assert one.stderr is not None
                assert one.stderr.readline() == "ready\n"
            gateways[0].send_signal(signal.SIGKILL)
            gateways[0].wait()
            gateways.append(started(config))
            ids = [report(viewer)["ids"], report(second)["ids"]]
            out, wrong = tabs.communicate(timeout=PATIENCE)
            assert tabs.returncode == 0, wrong
    finally:
        for process in gateways:
            process.kill()
            process.communicate()
    assert ids[0] == ids[1]
    assert len(set(ids[0])) == 2  # another session of the server, so that viewers begin anew
    found = json.loads(out)
    assert found["before"] == found["after"]
    assert found["before"]["sum"] == 3
    assert "/add has failed" in found["before"]["wrong"]
    assert found["before"]["feedback"] == {"at": 1}
    assert found["before"]["result"] == {"at": 3}
    assert "/count has failed" in found["before"]["failed"]
    assert found["before"]["cancelled"]
