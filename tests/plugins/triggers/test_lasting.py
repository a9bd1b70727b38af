"""What a trigger leaves undone is told: by whoever ends it, and after whatever ends the gateway."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from issuer import issuing
from plugins.triggers.gateway import OPERATOR, Rig, gateway, webhook
from plugins.triggers.receiver import receiver
from rcp_gateway.testing import MemoryClient
from rcp_kernel.errors import AdapterUnavailable
from rcp_web.logins import LOGINS

pytestmark = pytest.mark.anyio


async def test_one_made_with_a_token_says_when_it_ends_and_its_targets_hear_of_it(
    tmp_path: Path,
) -> None:
    async with receiver() as ops, issuing() as issuer:
        issuer.add("k1")
        options: dict[str, Any] = {"store": tmp_path / "s.db", "targets": {"ops": webhook(ops.url)}}
        async with gateway(issuer.table(), **options) as rig:
            lasting = await rig.add(name="lasting", alarm=True)
            assert lasting["status"] == "completed", lasting
            assert "ends" not in lasting["body"]
            ann = await rig.eventually(lambda: _client(rig, issuer.token()))
            made = await rig.add(ann, name="passing", notify=["ops"])
            assert made["status"] == "completed", made
            assert "when the gateway restarts" in made["body"]["ends"]
            assert "use an API key" in made["body"]["ends"]
        async with gateway(issuer.table(), **options) as rig:
            (got,) = await ops.count(1)
            assert "no longer valid" in (await rig.row("passing"))["stopped"]
            assert "stopped" not in await rig.row("lasting")
        assert got.body["type"] == "trigger.stopped"
        assert (got.body["data"]["trigger"], got.body["data"]["robot"]) == (
            "passing",
            "/tenant/alpha",
        )
        assert "credentials of ann" in got.body["data"]["detail"]


async def test_a_command_that_a_crash_cut_off_is_told_and_not_sent_again(tmp_path: Path) -> None:
    before, after = tmp_path / "before", tmp_path / "after"
    before.mkdir()
    async with gateway(store=before / "s.db") as rig:
        robot = rig.robot()
        robot.release.clear()
        await rig.made(execute={"path": "/action/dock", "value": 3.0})
        robot.measure("sensor/battery", 10.0)
        await rig.eventually(lambda: _started(robot.ran))
        shutil.copytree(before, after)  # what a crash leaves
        robot.release.set()
    async with gateway(store=after / "s.db") as rig:
        await rig.eventually(lambda: _unknown(rig))
        assert "not sent again" in (await rig.on_robot())["detail"]
        assert rig.robot().ran == []


async def _client(rig: Rig, token: str) -> MemoryClient | None:
    try:
        return rig.client(token)
    except AdapterUnavailable:  # the issuer's keys are on their way
        return None


async def _started(ran: list[Any]) -> bool:
    return bool(ran)


async def _unknown(rig: Rig) -> bool:
    return (await rig.on_robot()).get("outcome") == "unknown"


async def test_one_made_in_a_browser_says_that_it_ends_with_the_login(tmp_path: Path) -> None:
    async with gateway(store=tmp_path / "s.db") as rig:
        api = rig.served.server.client_api
        logins = api.service(LOGINS)
        assert logins is not None
        login = logins.begin(api.authenticate(OPERATOR), None, remember=True)
        made = await rig.add(rig.client(login.secret), name="passing", alarm=True)
        assert "logs out" in made["body"]["ends"]
        assert "API key instead of the cookie" in made["body"]["ends"]
        logins.end(login.secret)
        await rig.eventually(lambda: _stopped(rig))


async def _stopped(rig: Rig) -> bool:
    return "no longer valid" in (await rig.row("passing")).get("stopped", "")
