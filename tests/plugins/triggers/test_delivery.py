"""Notifications reach their targets once, whatever happens to these or to the gateway."""

from __future__ import annotations

import asyncio
import ssl
from email import message_from_bytes
from email.policy import default
from pathlib import Path
from typing import Any

import pytest
from aiosmtpd.smtp import SMTP

from certs import Authority
from plugins.triggers.gateway import Rig, gateway, webhook
from plugins.triggers.receiver import receiver
from rcp_gateway.testing import SteppedClock

pytestmark = pytest.mark.anyio


async def fire(rig: Rig, number: int, name: str = "low") -> None:
    """Let a trigger fire and clear so many times."""
    for _ in range(number):
        rig.robot().measure("event/fault", 1)
        rig.robot().measure("event/fault", 0)

    async def fired() -> bool:
        return (await rig.on_robot(name)).get("firings", 0) >= number

    await rig.eventually(fired)


FAULT = {"when": "event.fault == 1", "notify": ["ops"]}


async def waiting(rig: Rig) -> int:
    return (await rig.admin.request("read", "/system/status"))["body"]["triggers"]["waiting"]


async def test_a_webhook_is_signed_and_says_what_happened() -> None:
    async with receiver() as ops, gateway(targets={"ops": webhook(ops.url)}) as rig:
        await rig.made(message="Stuck", notify_cleared=True, alarm=True, **FAULT)
        await fire(rig, 1)
        first, second = await ops.count(2)
        assert (first.body["type"], second.body["type"]) == ("trigger.fired", "trigger.cleared")
        data = first.body["data"]
        assert (data["robot"], data["message"], data["by"]) == (
            "/tenant/alpha",
            "Stuck",
            "operator",
        )
        assert data["values"] == {"event.fault": 1}
        assert data["alarm"].startswith("al-")
        assert first.headers["webhook-id"] == first.headers["idempotency-key"]
        assert first.headers["webhook-id"] != second.headers["webhook-id"]


async def test_a_receiver_that_is_down_for_ten_minutes_gets_every_alarm_once(
    stepped: SteppedClock,
) -> None:
    async with receiver(now=lambda: stepped.now() / 1e9) as ops:
        options = {"targets": {"ops": webhook(ops.url)}, "per_minute": 100}
        async with gateway(clock=stepped.clock, **options) as rig:
            await rig.made(**FAULT)
            await ops.down()
            await fire(rig, 20)
            for _ in range(10):
                stepped.advance(60)
                await rig.eventually(lambda: _failing(rig))
            status = (await rig.admin.request("read", "/system/status"))["body"]
            assert (status["state"], status["triggers"]["waiting"]) == ("degraded", 20)
            await ops.up()
            stepped.advance(60)
            got = await ops.count(20)
            assert len({one.headers["webhook-id"] for one in got}) == len(got) == 20
            assert [one.body["timestamp"] for one in got] == sorted(
                one.body["timestamp"] for one in got
            )
            assert await rig.eventually(lambda: _none_waits(rig))
            assert len(ops.got) == 20


async def _failing(rig: Rig) -> bool:
    return (await rig.admin.request("read", "/system/status"))["body"]["triggers"]["failing"] == 1


async def _none_waits(rig: Rig) -> bool:
    return await waiting(rig) == 0


async def test_what_was_not_delivered_is_delivered_after_a_restart(tmp_path: Path) -> None:
    async with receiver() as ops:
        options: dict[str, Any] = {"targets": {"ops": webhook(ops.url)}, "store": tmp_path / "s.db"}
        ops.status = 503
        async with gateway(**options) as rig:
            await rig.made(alarm=True, **FAULT)
            rig.robot().measure("event/fault", 1)
            await ops.until(lambda: ops.asked >= 1)
            (alarm,) = await rig.alarms()
        ops.status = 200
        async with gateway(**options) as rig:
            (got,) = await ops.count(1)
            assert got.body["data"]["alarm"] == alarm["alarm"]
            assert (await rig.row())["by"] == "operator"
            assert (await rig.on_robot())["state"] == "active"
            rig.robot().measure("event/fault", 1)  # which it was before: nothing new
            await rig.eventually(lambda: _known(rig))
            assert (await rig.on_robot())["firings"] == 1
            assert [one["alarm"] for one in await rig.alarms()] == [alarm["alarm"]]
        assert len(ops.got) == 1


async def _known(rig: Rig) -> bool:
    return (await rig.on_robot())["condition"] == "true"


async def test_a_slow_receiver_delays_no_other() -> None:
    async with receiver() as slow, receiver() as ops:
        slow.gate.clear()
        targets = {"slow": webhook(slow.url), "ops": webhook(ops.url)}
        async with gateway(targets=targets) as rig:
            await rig.made(**FAULT | {"notify": ["slow", "ops"]})
            await fire(rig, 5)
            await ops.count(5)
            assert slow.got == []
            slow.gate.set()
            await slow.count(5)


async def test_redirects_are_not_followed(stepped: SteppedClock) -> None:
    async with receiver() as inside, receiver() as ops:
        ops.status, ops.extra = 302, f"location: {inside.url}\r\n"
        async with gateway(clock=stepped.clock, targets={"ops": webhook(ops.url)}) as rig:
            await rig.made(**FAULT)
            await fire(rig, 1)
            await rig.eventually(lambda: _failing(rig))
            status = (await rig.admin.request("read", "/system/status"))["body"]["triggers"]
            assert "redirects are not followed" in status["targets"][0]["error"]
            assert inside.asked == 0
            ops.status = 200
            stepped.advance(5)
            await ops.count(1)


async def test_one_that_is_refused_or_too_old_is_dropped_and_told(stepped: SteppedClock) -> None:
    async with receiver() as ops:
        targets = {"ops": webhook(ops.url)}
        async with gateway(clock=stepped.clock, targets=targets, keep=100) as rig:
            id_ = await rig.admin.subscribe("/system/audit", qos={"reliability": "reliable"})

            async def lost(result: str) -> dict[str, Any]:
                def told(message: dict[str, Any]) -> bool:
                    body = message.get("body") or {}
                    return message.get("id") == id_ and (body.get("what"), body.get("outcome")) == (
                        "notification",
                        result,
                    )

                return (await rig.admin.until(told))["body"]

            await rig.made(**FAULT)
            ops.status = 422
            await fire(rig, 1)
            assert (await lost("refused"))["message"] == "answered 422"
            ops.status = 500
            await fire(rig, 2)
            await rig.eventually(lambda: _failing(rig))
            stepped.advance(200)
            assert (await lost("expired"))["target"] == "ops"
            ops.status = 200
            await fire(rig, 3)
            await ops.count(1)


async def test_a_clock_that_is_set_forward_makes_none_too_old(stepped: SteppedClock) -> None:
    """As NTP does once there is a network, by which alone they can be delivered."""
    async with (
        receiver(now=lambda: stepped.now() / 1e9) as ops,
        gateway(clock=stepped.clock, targets={"ops": webhook(ops.url)}) as rig,
    ):
        await rig.made(**FAULT)
        await ops.down()
        await fire(rig, 1)
        await rig.eventually(lambda: _failing(rig))
        stepped.adjust(30 * 86_400)
        await ops.up()
        stepped.advance(60)
        await ops.count(1)


async def test_one_of_1970_is_delivered_after_a_restart(
    stepped: SteppedClock, tmp_path: Path
) -> None:
    """A robot without a battery for its clock, and without a network until after the restart."""
    async with receiver(now=lambda: stepped.now() / 1e9) as ops:
        options: dict[str, Any] = {"targets": {"ops": webhook(ops.url)}, "store": tmp_path / "s.db"}
        back = -(stepped.now() // 10**9)
        stepped.adjust(back)
        await ops.down()
        async with gateway(clock=stepped.clock, **options) as rig:
            await rig.made(**FAULT)
            await fire(rig, 1)
            await rig.eventually(lambda: _failing(rig))
        stepped.adjust(-back)
        await ops.up()
        async with gateway(clock=stepped.clock, **options):
            (got,) = await ops.count(1)
            assert got.body["type"] == "trigger.fired"


async def test_a_full_queue_drops_the_oldest() -> None:
    async with receiver() as ops:
        ops.gate.clear()
        async with gateway(targets={"ops": webhook(ops.url)}, queue=3) as rig:
            await rig.made(**FAULT)
            await fire(rig, 1)
            await ops.until(lambda: ops.asked == 1)
            await fire(rig, 6)
            ops.gate.set()
            got = await ops.count(3)
            status = (await rig.admin.request("read", "/system/status"))["body"]["triggers"]
            assert (len(got), status["lost"]) == (3, 4)


async def test_ntfy_gets_a_push() -> None:
    async with receiver(signed=False) as server:
        url = server.url.replace("/hook", "/robots")
        targets = {"ops": {"kind": "ntfy", "url": url, "token": "tk_1"}}
        async with gateway(targets=targets) as rig:
            await rig.made(message="Akku schwach", severity="critical", **FAULT)
            await fire(rig, 1)
            (got,) = await server.count(1)
            assert (got.path, got.body["topic"], got.body["priority"]) == ("/", "robots", 5)
            assert got.body["message"].startswith("Akku schwach")
            assert got.headers["authorization"] == "Bearer tk_1"


class _Mailbox:
    def __init__(self) -> None:
        self.got: list[tuple[Any, list[str], bytes]] = []
        self.refuse = ""

    async def handle_DATA(self, _server: Any, _session: Any, envelope: Any) -> str:  # noqa: N802
        if self.refuse:
            return self.refuse
        self.got.append((envelope.mail_from, envelope.rcpt_tos, envelope.content))
        return "250 OK"


@pytest.mark.parametrize("encrypted", [False, True])
async def test_e_mail_reaches_its_recipients(
    tmp_path: Path,
    encrypted: bool,  # noqa: FBT001
) -> None:
    mailbox, more, facts = _Mailbox(), {}, {"tls": "none"}
    if encrypted:
        authority = Authority(tmp_path)
        signed = authority.sign("localhost")
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        context.load_cert_chain(*signed.pair)
        more = {"tls_context": context, "require_starttls": True}
        facts = {"tls": "starttls", "ca": str(authority.file)}
    loop = asyncio.get_running_loop()
    server = await loop.create_server(lambda: SMTP(mailbox, **more), "127.0.0.1", 0)
    target = {
        "kind": "smtp",
        "host": "localhost" if encrypted else "127.0.0.1",
        "port": server.sockets[0].getsockname()[1],
        "sender": "robots@example.org",
        "to": ["ops@example.org", "lead@example.org"],
        **facts,
    }
    mailbox.refuse = "451 later"
    async with server, gateway(targets={"ops": target}) as rig:
        await rig.made(message="Batterie schwach: prüfen", severity="critical", **FAULT)
        await fire(rig, 1)
        await rig.eventually(lambda: _failing(rig))
        mailbox.refuse = ""
        await rig.eventually(lambda: _none_waits(rig))
    ((sender, to, content),) = mailbox.got
    message = message_from_bytes(content, policy=default)
    assert (sender, to) == ("robots@example.org", ["ops@example.org", "lead@example.org"])
    assert message["subject"] == "critical: /tenant/alpha low"
    assert message["message-id"].endswith("@example.org>")
    assert "prüfen" in message.get_content()
