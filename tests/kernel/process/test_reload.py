"""Reloads: in order, the newest wins, and rights do not wait for robots."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path

import httpx
import pytest
from structlog.testing import capture_logs

from configuration import backend, key, listener
from kernel.world import BOUND, CONFIG, Client, NoOptions, Robot, prepared
from rcp_gateway.reload import apply
from rcp_gateway.server import Prepared, Server, running
from rcp_kernel.config.file import parse
from rcp_kernel.errors import RcpError
from rcp_kernel.spi import BackendKind, Host
from rcpd.reload import reload

pytestmark = pytest.mark.anyio
STRANGER = key("stranger", "stranger-stranger", role="operator")
SECOND = backend("second", "beta")
THIRD = SECOND.replace("second", "third").replace("beta", "gamma")


class Slow:
    """A gateway whose backends close when a test says so."""

    def __init__(self, server: Server) -> None:
        self.server = server
        self.closing = asyncio.Event()
        self.release = asyncio.Event()
        self.open: list[str] = []

    def prepare(self, text: str) -> Prepared:
        made = prepared(parse(text, "test"), [])
        made.plugins.backends["robot"] = BackendKind("robot", NoOptions, self.robot)
        return made

    @asynccontextmanager
    async def robot(self, _config: NoOptions, host: Host) -> AsyncGenerator[Robot]:
        robot = Robot(host)
        robot.declare()
        name = getattr(host, "name", "")
        self.open.append(name)
        try:
            yield robot
        finally:
            self.closing.set()
            await self.release.wait()
            self.open.remove(name)

    def lets_in(self, key: str) -> bool:
        try:
            Client(self.server.client_api, key)
        except RcpError:
            return False
        return True


@asynccontextmanager
async def slow(text: str) -> AsyncGenerator[Slow]:
    made = Slow.__new__(Slow)
    Slow.__init__(made, None)  # pyright: ignore[reportArgumentType] - it comes at once
    async with running(made.prepare(text)) as server:
        made.server = server
        try:
            yield made
        finally:
            made.release.set()


async def test_the_newer_of_two_reloads_wins_though_the_first_is_slow_to_close() -> None:
    async with asyncio.timeout(BOUND), slow(CONFIG + SECOND + STRANGER) as world:
        assert world.lets_in("stranger-stranger")
        first = asyncio.create_task(apply(world.server, world.prepare(CONFIG + STRANGER + THIRD)))
        await world.closing.wait()  # of "second", which the first takes away
        second = asyncio.create_task(apply(world.server, world.prepare(CONFIG)))
        await asyncio.sleep(0)
        assert not world.lets_in("stranger-stranger"), "a revoked key waits for no backend"
        assert not second.done()
        world.release.set()
        await first
        assert not world.lets_in("stranger-stranger"), "the older reload brought it back"
        await second
        assert not world.lets_in("stranger-stranger")
        assert world.lets_in("operator-operator")
        assert [supervisor.name for supervisor in world.server.supervisors] == ["robot"]
        assert world.open == ["robot"], "what only the older configuration had was started"


async def test_a_key_is_revoked_before_a_slow_backend_is_closed() -> None:
    async with asyncio.timeout(BOUND), slow(CONFIG + SECOND + STRANGER) as world:
        task = asyncio.create_task(apply(world.server, world.prepare(CONFIG)))
        await world.closing.wait()
        assert not world.lets_in("stranger-stranger")
        world.release.set()
        await task


async def test_of_many_reloads_at_once_the_last_is_what_runs() -> None:
    async with asyncio.timeout(BOUND), slow(CONFIG + SECOND) as world:
        texts = [CONFIG + THIRD, CONFIG + SECOND, CONFIG, CONFIG + STRANGER + THIRD]
        tasks = [asyncio.create_task(apply(world.server, world.prepare(text))) for text in texts]
        world.release.set()
        await asyncio.gather(*tasks)
        assert [supervisor.name for supervisor in world.server.supervisors] == ["robot", "third"]
        assert world.lets_in("stranger-stranger")


async def test_a_bug_in_what_checks_a_reload_changes_nothing_and_is_logged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError

    file = tmp_path / "rcp.toml"
    file.write_text(CONFIG)
    async with slow(CONFIG) as world:
        monkeypatch.setattr("rcp_gateway.reload.prepare", broken)
        with capture_logs() as said:
            await reload(world.server, file)
        assert [one["event"] for one in said] == ["reload_failed"]
        assert world.lets_in("operator-operator")
        world.release.set()


SERVED = listener() + backend("rover", use="sim")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGHUP")
async def test_two_hangups_in_a_row_leave_the_newer_file(tmp_path: Path) -> None:
    file = tmp_path / "rcp.toml"
    operator = STRANGER.replace("stranger", "operator")
    file.write_text(SERVED + operator + STRANGER)
    rcpd = Path(sys.executable).with_name("rcpd")
    process = await asyncio.create_subprocess_exec(
        rcpd, "serve", file, stderr=asyncio.subprocess.PIPE
    )
    assert process.stderr is not None
    try:
        async with asyncio.timeout(60):
            while "serving on " not in (line := (await process.stderr.readline()).decode()):
                assert line
            url = line.rpartition(" ")[2].strip()
            drained = asyncio.create_task(process.stderr.read())
            file.write_text(SERVED.replace("rover", "other") + operator + STRANGER)
            os.kill(process.pid, signal.SIGHUP)
            await asyncio.sleep(0.05)  # so that the kernel does not make one signal of both
            file.write_text(SERVED.replace("rover", "third") + operator)
            os.kill(process.pid, signal.SIGHUP)
            async with httpx.AsyncClient(base_url=url) as http:
                while await _asked(http, "stranger") != 401:  # noqa: ASYNC110 - of another process
                    await asyncio.sleep(0.02)
                while '"third"' not in (await http.get(_STATUS, headers=_key("operator"))).text:
                    assert await _asked(http, "stranger") == 401
                    await asyncio.sleep(0.02)
                assert await _asked(http, "stranger") == 401
                text = (await http.get(_STATUS, headers=_key("operator"))).text
                assert '"other"' not in text
            process.terminate()
            await drained
            assert await process.wait() == 0
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


_STATUS = "/rcp/v1/context/system/status"


def _key(name: str) -> dict[str, str]:
    return {"authorization": f"Bearer {name}-{name}"}


async def _asked(http: httpx.AsyncClient, name: str) -> int:
    return (await http.get(_STATUS, headers=_key(name))).status_code
