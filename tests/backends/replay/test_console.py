"""`rcpctl replay`, as a person types it."""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path

import pytest

from backends.replay.recorded import written
from configuration import backend, key, listener, role, rule
from rcp_gateway.testing import serve
from rcp_kernel.config.file import parse
from rcp_replay import rcp_backends

pytestmark = pytest.mark.anyio
ADMIN = "admin-admin-admin-admin"
PLAYER = "player-player-player-player"
RCPCTL = str(Path(sys.executable).with_name("rcpctl"))
BOUND = 60.0  # s


async def test_replays_are_listed_and_each_is_controlled(tmp_path: Path) -> None:
    file = str(written(tmp_path, 10))
    replays = "".join(
        backend(name, name, use="replay", files=[file], paused=True) for name in ("then", "again")
    )
    player = role("player", rule("execute discover", "/service/**"))
    keys = key("admin", ADMIN) + player + key("player", PLAYER, tenants=["then"])
    config = parse(listener() + replays + keys, "test")
    async with serve(config, *rcp_backends()) as served:
        for supervisor in served.server.supervisors:
            await asyncio.wait_for(supervisor.settled.wait(), BOUND)
        (url,) = [facts["url"] for facts in served.server.status.transports if "url" in facts]

        async def rcpctl(*words: str, code: int = 0, token: str = ADMIN) -> str:
            process = await asyncio.create_subprocess_exec(
                RCPCTL,
                "replay",
                *words,
                "--url",
                url,
                "--token",
                token,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.STDOUT,
            )
            out, _ = await asyncio.wait_for(process.communicate(), BOUND)
            assert process.returncode == code, out.decode()
            return out.decode()

        listed = await rcpctl("--text")
        assert "/tenant/then/sensor/replay" in listed
        assert "/tenant/again/sensor/replay" in listed
        assert "paused" in listed
        assert "name one of them" in await rcpctl("--pause", code=1)
        assert "no replay at /tenant/now" in await rcpctl("/tenant/now", code=1)
        state = json.loads(await rcpctl("/tenant/then", "--seek", "5.05", "--speed", "2", "--loop"))
        assert state["path"] == "/tenant/then/sensor/replay"
        assert (state["state"], state["speed"], state["loop"]) == ("paused", 2.0, True)
        assert state["elapsed"] == pytest.approx(5.05)
        stepped = json.loads(await rcpctl("/tenant/then/service/replay", "--step", "1", "--once"))
        assert stepped["elapsed"] == pytest.approx(5.1)
        assert stepped["loop"] is False
        assert "playing" in await rcpctl("/tenant/then", "--play", "--text")
        assert "paused" in await rcpctl("/tenant/again", "--text")
        # Who may control it and not read it, by a path of the own tenant.
        assert "that you may control" in await rcpctl("/now", "--play", code=1, token=PLAYER)
        sought = json.loads(
            await rcpctl("/service/replay", "--pause", "--seek", "5.05", token=PLAYER)
        )
        assert sought["path"] == "/tenant/then/sensor/replay"
        assert sought["elapsed"] == pytest.approx(5.05)
        assert "no replay." in await rcpctl(code=1, token=PLAYER)
