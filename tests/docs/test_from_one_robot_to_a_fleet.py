"""Each command of the tutorial succeeds, in the order of the page."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

from docs.blocks import blocks_of
from docs.demo import BIN
from docs.pages import DOCS
from ports import free_port
from rcp_client import connect
from rcp_client.errors import RcpError
from rcp_gateway.testing import eventually

PAGE = DOCS / "from-one-robot-to-a-fleet.md"
PORTS = ("8080", "8081", "8082", "7447")
FILES = iter(("hub.toml", "dial.toml"))
_READY = 120.0  # s that gateways may take on a busy machine
_PATIENCE = 120  # s for one command


class Reader:
    """Somebody who types what the page says, and starts what serves in terminals of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.ports = {port: str(free_port()) for port in PORTS}
        kept = {name: value for name, value in os.environ.items() if not name.startswith("RCP_")}
        self.environment = {**kept, "PATH": f"{BIN}:{os.environ['PATH']}", "PWD": str(folder)}
        self.serving: dict[str, subprocess.Popen[bytes]] = {}
        self.robots: list[str] = []
        """Those that have dialled in."""

    def here(self, text: str) -> str:
        """Return a text of the page with the ports of this run."""
        return re.sub("|".join(PORTS), lambda found: self.ports[found[0]], text)

    def write(self, text: str) -> None:
        (self.folder / next(FILES)).write_text(self.here(text), encoding="utf-8")

    async def type(self, line: str) -> None:
        line = self.here(line)
        if "rcpd serve" in line:
            self.serve(line)
            await self.wait()
        elif line.startswith("export "):
            names = re.findall(r"(\w+)=", line)
            shown = self.run(f"{line}; echo {' '.join(f'${name}' for name in names)}")
            self.environment.update(zip(names, shown.split(), strict=True))
        elif not line.startswith("pip "):
            self.run(line)

    def run(self, line: str) -> str:
        done = subprocess.run(
            ["bash", "-c", line],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=_PATIENCE,
        )
        assert done.returncode == 0, f"{line}: {done.stdout}{done.stderr}"
        return done.stdout

    def serve(self, line: str) -> None:
        *given, _, _, config = shlex.split(line)
        if before := self.serving.pop(config, None):
            before.send_signal(signal.SIGINT)
            before.wait(_PATIENCE)
        environment = {**self.environment, **dict(one.split("=", 1) for one in given)}
        with (self.folder / f"{config.replace('/', '-')}.log").open("wb") as log:
            self.serving[config] = subprocess.Popen(
                [BIN / "rcpd", "serve", config],
                cwd=self.folder,
                env=environment,
                stdout=log,
                stderr=log,
            )
        if robot := re.match(r"ROBOT=(\w+)", line):
            self.robots.append(robot[1])

    async def wait(self) -> None:
        """Wait until the hub, or else the one robot, shows all robots ready."""
        hub = "hub.toml" in self.serving
        port, key = ("8080", "ann.key") if hub else ("8081", "r1/operator.key")
        token = (self.folder / key).read_text().strip()
        found: Any = None

        async def ready() -> bool:
            nonlocal found
            try:
                async with connect(f"http://127.0.0.1:{self.ports[port]}", token=token) as client:
                    found = await client.read("/system/robots")
            except RcpError as error:
                found = error
                return False
            return len(found) >= len(self.robots) and all(one["state"] == "ready" for one in found)

        await eventually(ready, "all robots are ready", _READY)

    def stop(self) -> None:
        for process in self.serving.values():
            process.send_signal(signal.SIGINT)
        for process in self.serving.values():
            try:
                process.wait(_PATIENCE)
            finally:
                process.kill()


@pytest.fixture
def reader(tmp_path: Path) -> Generator[Reader]:
    made = Reader(tmp_path)
    try:
        yield made
    finally:
        made.stop()


@pytest.mark.paired
async def test_every_command_of_the_page_succeeds_in_order(reader: Reader) -> None:
    for block in blocks_of(PAGE):
        if block.language == "toml":
            reader.write(block.text)
            continue
        for line in block.text.splitlines():
            await reader.type(line)
    assert reader.robots == ["r1", "r2"]
