"""Roll-out of a configuration over a hub, with hub, robots and operator in processes of their own."""

from __future__ import annotations

import asyncio
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

from backends.fleet.rig import SIM
from configuration import backend, key, listener, role, rule, table
from durability.process import until
from hubkeys import HubKey
from ports import free_port
from rcp_client import Client, connect
from rcp_gateway.testing import ADMIN, OPERATOR, VIEWER, eventually
from rcp_kernel.errors import RcpError, UnknownPath

RCPD = Path(sys.executable).with_name("rcpd")
PATH = "/system/configuration"
SECRET = "a-secret-that-nobody-on-the-way-may-read"
_BOUND = 60.0  # s, on any machine
_LOOK = rule("discover read execute", PATH)


class _Gateway:
    """`rcpd serve` of one file."""

    def __init__(self, folder: Path, name: str, text: str) -> None:
        self.file, self._log = folder / f"{name}.toml", folder / f"{name}.log"
        self.file.write_text(text)
        self.file.chmod(0o600)
        self.start()

    def start(self) -> None:
        self._log.write_text("")
        with self._log.open("a") as stderr:
            self.process = subprocess.Popen([RCPD, "serve", self.file], stderr=stderr)
        until(lambda: self.urls() or self.process.poll() is not None)
        assert self.urls(), self.log

    @property
    def log(self) -> str:
        return self._log.read_text()

    def urls(self) -> list[str]:
        return re.findall(r"serving on (\S+)", self.log)

    def connect(self, token: str) -> Client:
        return connect(self.urls()[-1], token=token)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(_BOUND)

    @property
    def text(self) -> str:
        return self.file.read_text()

    async def state(self) -> dict[str, Any]:
        """What it says of its configuration; empty while it cannot be asked."""
        try:
            async with self.connect(ADMIN) as client:
                return await client.read(PATH)
        except (RcpError, OSError):
            return {}

    async def is_in(self, phase: str) -> None:
        async def reached() -> bool:
            return (await self.state()).get("phase") == phase

        await eventually(reached, f"{self.file.name} is in {phase}", _BOUND)


class _Fleet:
    def __init__(self, folder: Path) -> None:
        self.folder, self.port = folder, free_port()
        self.key = HubKey()
        (folder / "hub.key").write_text(self.key.private_pem)
        (folder / "hub.key").chmod(0o600)
        fleet = backend(
            "fleet",
            use="fleet",
            hub="h1",
            listen=[f"tcp/127.0.0.1:{self.port}"],
            key=str(folder / "hub.key"),
        )
        people = key("ann", OPERATOR, roles={"alpha": ["operator", "maintainer"]})
        people += key("ben", VIEWER, role="operator")
        looks = role("maintainer", rule("read execute", "/service/*/gateway/configuration"))
        store = table("store", path=str(folder / "hub.sqlite3"))
        self.hub = _Gateway(folder, "hub", listener() + fleet + looks + people + store)
        self.robots: dict[str, _Gateway] = {}

    def text(self, name: str) -> str:
        connect_to = [f"tcp/127.0.0.1:{self.port}"]
        zenoh = table("transports.zenoh", gateway=name, tenant="alpha", connect=connect_to)
        return (
            f"{listener()}{zenoh}{table('features', configuration=True)}{SIM}"
            f"{role('maintainer', _LOOK)}{key('admin', ADMIN)}"
            f"{table('store', path=str(self.folder / f'{name}.sqlite3'))}"
            f"{self.key.table('[{}]'.format(', '.join(_ROLES)))}"
        )

    async def add(self, name: str) -> _Gateway:
        robot = self.robots[name] = _Gateway(self.folder, name, self.text(name))

        async def there() -> bool:
            async with self.hub.connect(OPERATOR) as ann:
                try:
                    await ann.read(f"/service/{name}/gateway/configuration", fresh=True)
                except RcpError:
                    return False
                return True

        await eventually(there, f"{name} is at the hub", _BOUND)
        return robot

    def roll_out(
        self, text: str, *more: str, seconds: float = 300.0, token: str = OPERATOR
    ) -> subprocess.Popen[str]:
        file = self.folder / "new.toml"
        file.write_text(text)
        robots = [part for name in self.robots for part in ("--robot", name)]
        return subprocess.Popen(
            [
                *(RCPD, "fleet", "roll-out", file, *robots, *more, "--seconds", str(seconds)),
                *("--url", self.hub.urls()[-1], "--token", token),
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    async def record(self, name: str, **wanted: Any) -> dict[str, Any]:
        """Return the record of a robot's audit log that has these facts."""
        async with asyncio.timeout(_BOUND), self.robots[name].connect(ADMIN) as client:
            async for update in client.subscribe("/system/audit", history=200):
                if wanted.items() <= update.body.items():
                    return update.body
        raise AssertionError(wanted)

    def end(self) -> None:
        for one in (*self.robots.values(), self.hub):
            one.process.terminate()
        for one in (*self.robots.values(), self.hub):
            one.process.wait(_BOUND)


_ROLES = ('"operator"', '"maintainer"')


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[_Fleet]:
    made = _Fleet(tmp_path)
    yield made
    made.end()


def _end(process: subprocess.Popen[str], code: int) -> str:
    out, _ = process.communicate(timeout=300)
    assert process.returncode == code, out
    return out


async def test_a_good_file_is_confirmed_and_nobody_on_the_way_can_read_it(fleet: _Fleet) -> None:
    robot = await fleet.add("r7")
    long = f"# {'x' * 98}\n" * 2000
    text = robot.text + key("carl", SECRET, role="viewer") + long
    out = _end(fleet.roll_out(text), 0)
    assert "r7: confirmed" in out
    assert robot.text == text
    assert robot.file.stat().st_mode & 0o777 == 0o600
    state = await robot.state()
    assert (state["phase"], state["by"], state["via"]) == ("confirmed", "ann", "h1")
    async with robot.connect(SECRET):
        pass
    for outcome in ("proposed", "confirmed"):
        found = await fleet.record("r7", what="configuration", outcome=outcome)
        assert (found["principal"], found["via"]) == ("ann", "h1")
    assert "has it already" in _end(fleet.roll_out(text), 0)
    fleet.end()
    for file in fleet.folder.glob("*.sqlite3*"):
        assert SECRET.encode() not in file.read_bytes(), file
    robot.start()
    assert robot.text == text


async def test_a_file_that_fails_the_check_changes_nothing_and_ends_the_roll_out(
    fleet: _Fleet,
) -> None:
    robots = [await fleet.add("r7"), await fleet.add("r8")]
    before = [one.text for one in robots]
    out = _end(fleet.roll_out(f"{before[0]}[limit]\nx = 1\n"), 1)
    assert "r7: " in out
    assert "did you mean `limits`?" in out
    assert "r8" not in out
    assert [one.text for one in robots] == before
    out = _end(fleet.roll_out(before[0].replace('"r7"', '"r9"')), 1)
    assert "it changes transports" in out
    assert [one.text for one in robots] == before


async def test_a_file_without_the_hub_rolls_back_by_itself(fleet: _Fleet) -> None:
    robot = await fleet.add("r7")
    before = robot.text
    text = before.replace(fleet.key.pem, HubKey().pem)
    _end(fleet.roll_out(text, seconds=1.0), 1)
    await robot.is_in("rolled_back")
    assert (await robot.state())["reason"] == "it was not confirmed within 1 s"
    assert robot.text == before
    await fleet.record("r7", what="configuration", outcome="rolled_back")


async def test_a_file_that_cuts_the_robot_from_its_router_rolls_back_by_itself(
    fleet: _Fleet,
) -> None:
    robot = await fleet.add("r7")
    before = robot.text
    text = before.replace(f"127.0.0.1:{fleet.port}", f"127.0.0.1:{free_port()}")
    _end(fleet.roll_out(text, "--restart", seconds=2.0), 1)
    await robot.is_in("rolled_back")
    assert robot.text == before
    assert robot.process.poll() is None


async def test_a_file_that_needs_a_restart_is_confirmed_after_it(fleet: _Fleet) -> None:
    robot = await fleet.add("r7")
    before = robot.text
    text = before.replace('name = "rover"', 'name = "truck"') + table("log", level="debug")
    assert "r7: confirmed" in _end(fleet.roll_out(text, "--restart"), 0)
    assert robot.text == text


async def test_a_file_with_which_it_cannot_start_rolls_back_at_once(fleet: _Fleet) -> None:
    robot = await fleet.add("r7")
    before = robot.text
    text = before.replace("port = 0", f"port = {fleet.port}")  # the router's
    out = _end(fleet.roll_out(text, "--restart", seconds=600.0), 1)
    assert "the gateway cannot start with it" in out
    assert robot.text == before


async def test_a_file_with_which_a_backend_is_not_ready_again_rolls_back(fleet: _Fleet) -> None:
    robot = await fleet.add("r7")
    before = robot.text
    nowhere = [f"tcp/127.0.0.1:{free_port()}"]
    more = backend("more", use="fleet", hub="h9", connect=nowhere, token=ADMIN)
    _end(fleet.roll_out(before + more, seconds=2.0), 1)
    await robot.is_in("rolled_back")
    assert robot.text == before


async def test_a_gateway_killed_on_probation_rolls_back_at_its_next_start(fleet: _Fleet) -> None:
    robot = await fleet.add("r7")
    before = robot.text
    text = before.replace(fleet.key.pem, HubKey().pem)
    process = fleet.roll_out(text, seconds=600.0)
    await robot.is_in("probation")
    assert robot.text == text
    robot.kill()
    robot.start()
    assert robot.text == before
    assert "the gateway ended before it was confirmed" in _end(process, 1)
    assert "the gateway ended" in (await robot.state())["reason"]


async def test_a_person_without_the_right_is_refused_and_on_record(fleet: _Fleet) -> None:
    robot = await fleet.add("r7")
    before = robot.text
    out = _end(fleet.roll_out(before + "# more\n", token=VIEWER), 1)
    assert "r7: it is not at this hub, lacks the feature `configuration`, or gives you no" in out
    path = "/service/r7/gateway/configuration"
    async with fleet.hub.connect(VIEWER) as ben:
        with pytest.raises(UnknownPath):
            await ben.execute(path, {"confirm": "0" * 64})
    found = await fleet.record("r7", principal="ben", request="execute")
    assert (found["what"], found["via"], found["outcome"]) == ("denial", "h1", "unknown_path")
    assert robot.text == before
    assert "phase" not in await robot.state()
