"""Who may see and do what: rights, tokens, tenants."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
import pytest
from websockets.exceptions import InvalidStatus

from configuration import backend, key, role, rule
from plugins.rosbridge.rig import OPEN, OPERATOR, ROVER, page, site
from rcp_gateway.testing import eventually

CLOSED = "anonymous = false\n"
GUEST = "guest-of-these-tests"
TWO = ROVER + backend("other", "beta", use="sim", seed=2)
WATCHER = role(
    "watcher", rule("*", "/**"), deny=[rule("*", "/actuator/**", "/sensor/velocity")]
) + key("watcher", GUEST)


async def test_nothing_works_before_the_client_is_known() -> None:
    async with site(CLOSED, ROVER) as gateway, page(gateway) as client:
        await client.send(op="subscribe", topic="/odom", id="s1")
        told = await client.status("authentication required")
        assert told["id"] == "s1"
        await client.send(op="auth", id="a1", token="wrong")
        assert "authentication failed" in (await client.status("authentication"))["msg"]
        await client.send(op="auth", id="a2", token=OPERATOR)
        await client.send(op="subscribe", topic="/odom")
        assert (await client.status("authenticated as operator"))["id"] == "a2"
        assert await client.message("/odom")


async def test_a_token_in_place_of_the_mac_of_rosauth() -> None:
    async with site(CLOSED, ROVER) as gateway, page(gateway) as client:
        facts = {"client": "c", "dest": "d", "rand": "r", "t": 1, "level": "user", "end": 2}
        await client.send(op="auth", mac=OPERATOR, **facts)
        assert "/odom" in (await client.values("/rosapi/topics"))["topics"]


async def test_a_token_in_the_header() -> None:
    async with site(CLOSED, ROVER) as gateway:
        async with page(gateway, OPERATOR) as client:
            assert "/odom" in (await client.values("/rosapi/topics"))["topics"]
        with pytest.raises(InvalidStatus) as refused:
            async with page(gateway, "wrong"):
                pass
        assert refused.value.response.status_code == 401


async def test_a_token_in_the_url_only_where_it_is_configured() -> None:
    path = f"/rosbridge?token={OPERATOR}"
    async with site(CLOSED, ROVER) as gateway:
        with pytest.raises(InvalidStatus) as refused:
            async with page(gateway, path=path):
                pass
        assert refused.value.response.status_code == 400
    async with site(CLOSED, ROVER, token_in_url=True) as gateway:
        async with page(gateway, path=path) as client:
            assert "/odom" in (await client.values("/rosapi/topics"))["topics"]
        gateway.url = f"ws://127.0.0.1:{gateway.port}"
        async with page(gateway, path=f"/?token={OPERATOR}") as client:
            assert "/odom" in (await client.values("/rosapi/topics"))["topics"]


async def test_what_a_client_may_not_do_does_not_exist_for_it() -> None:
    async with site(CLOSED, ROVER, WATCHER) as gateway, page(gateway, GUEST) as client:
        topics = (await client.values("/rosapi/topics"))["topics"]
        assert "/odom" in topics
        assert "/cmd_vel" not in topics
        assert "/velocity" not in topics
        await client.send(op="publish", topic="/cmd_vel", msg={"linear": {"x": 0.1}})
        await client.status("nothing takes messages on /cmd_vel")
        await client.send(op="publish", topic="/actuator/cmd_vel", msg={"linear": {"x": 0.1}})
        await client.status("nothing takes messages on /actuator/cmd_vel")
        # What it may not read is not in the message beside what it may.
        async with page(gateway, OPERATOR) as driver:
            await driver.send(op="subscribe", topic="/odom")
            await driver.send(op="publish", topic="/cmd_vel", msg={"linear": {"x": 0.3}})
            await driver.until(
                lambda m: m["op"] == "publish" and m["msg"]["twist"]["twist"]["linear"]["x"] > 0.1
            )
            await client.send(op="subscribe", topic="/odom")
            seen = await client.message("/odom")
            assert seen["twist"]["twist"]["linear"]["x"] == 0.0


async def test_each_tenant_has_its_names() -> None:
    both = key("boss", GUEST, role="operator", tenants=["*"])
    async with site(CLOSED, TWO, both) as gateway:
        async with page(gateway, GUEST, "/rosbridge?tenant=beta") as client:
            assert "/odom" in (await client.values("/rosapi/topics"))["topics"]
            assert (await client.values("/rosapi/nodes"))["nodes"] == ["/other"]
        with pytest.raises(InvalidStatus):
            async with page(gateway, GUEST, "/rosbridge?tenant=gamma"):
                pass
    async with site(CLOSED, TWO, both, tenant="beta") as gateway, page(gateway, GUEST) as client:
        assert (await client.values("/rosapi/nodes"))["nodes"] == ["/other"]


async def test_two_commanders_where_a_lease_is_required() -> None:
    safety = '[safety]\nlease_required = ["/actuator/**"]\n'
    boss = role("boss", rule("*", "/**"), priority=90) + key(
        "boss", GUEST, role=["operator", "boss"]
    )

    def fast(message: dict[str, Any]) -> bool:
        return message.get("topic") == "/velocity" and message["msg"]["twist"]["linear"]["x"] > 0.1

    async with (
        site(OPEN, ROVER, boss, limits=safety, lease=1.0) as gateway,
        page(gateway) as first,
        page(gateway) as second,
        page(gateway, GUEST) as chief,
    ):
        await first.send(op="subscribe", topic="/velocity")
        await first.send(op="publish", topic="/cmd_vel", msg={"linear": {"x": 0.3}})
        await first.until(fast)
        await second.send(op="publish", topic="/cmd_vel", msg={"linear": {"x": -0.3}})
        assert "lease" in (await second.status("/cmd_vel"))["msg"]
        lease = {"do": "acquire", "scope": "/actuator", "take": True, "reason": "by hand"}
        assert (await chief.call("/system/leases", lease))["result"]
        assert (await first.status("by hand"))["level"] == "error"
        await first.send(op="publish", topic="/cmd_vel", msg={"linear": {"x": 0.3}})
        await first.status("/cmd_vel")  # it does not take the lease back by itself


async def test_a_lease_is_kept_until_the_last_publisher_of_a_topic_has_gone() -> None:
    safety = '[safety]\nlease_required = ["/actuator/**"]\n'
    ids = [f"advertise:/cmd_vel:{number}" for number in range(40)]
    async with (
        site(OPEN, ROVER, limits=safety, lease=60.0) as gateway,
        page(gateway) as client,
        page(gateway) as other,
    ):

        async def is_free() -> bool:
            lease = await other.call("/system/leases", {"do": "acquire", "scope": "/actuator"})
            return bool(lease["result"])

        await client.send(op="subscribe", topic="/cmd_vel")
        for id_ in ids:
            await client.send(op="advertise", topic="/cmd_vel", id=id_)
        await client.send(op="publish", topic="/cmd_vel", msg={"linear": {"x": 0.1}})
        await client.until(
            lambda m: m.get("topic") == "/cmd_vel" and m["msg"]["linear"]["x"] == 0.1
        )
        for id_ in ids[:-1]:
            await client.send(op="unadvertise", topic="/cmd_vel", id=id_)
        await client.values("/rosapi/get_time")  # all that was sent before it has been handled
        assert not await is_free()
        await client.send(op="unadvertise", topic="/cmd_vel", id=ids[-1])
        await eventually(is_free, "the lease is released")


async def test_a_lease_is_acquired_again_after_a_pause() -> None:
    safety = '[safety]\nlease_required = ["/actuator/**"]\n'

    def told(message: dict[str, Any]) -> bool:
        return message.get("topic") == "/cmd_vel" and message["msg"]["linear"]["x"] == 0.2

    async with (
        site(OPEN, ROVER, limits=safety, lease=0.2) as gateway,
        page(gateway) as client,
        page(gateway) as other,
    ):
        await client.send(op="subscribe", topic="/cmd_vel")
        await client.send(op="publish", topic="/cmd_vel", msg={"linear": {"x": 0.1}})
        await client.until(
            lambda m: m.get("topic") == "/cmd_vel" and m["msg"]["linear"]["x"] == 0.1
        )

        async def expired() -> bool:
            leases = await other.call("/system/leases", {"do": "acquire", "scope": "/actuator"})
            return bool(leases["result"])

        await eventually(expired, "the lease has ended by itself")
        await other.call("/system/leases", {"do": "release", "scope": "/actuator"})
        await client.send(op="publish", topic="/cmd_vel", msg={"linear": {"x": 0.2}})
        await client.until(told)


async def test_a_key_that_is_withdrawn_ends_the_connection() -> None:
    async with site(CLOSED, ROVER) as gateway, page(gateway, OPERATOR) as client:
        await client.values("/rosapi/get_time")
        config = gateway.kernel.settings.config
        gateway.kernel.reconfigure(msgspec.structs.replace(config, keys=()))
        async with asyncio.timeout(60):
            await client.socket.wait_closed()


async def test_the_rover_of_a_page_that_is_closed_stops() -> None:
    async with site(OPEN, ROVER) as gateway, page(gateway) as watcher:
        await watcher.send(op="subscribe", topic="/velocity")
        async with page(gateway) as driver:
            await driver.send(op="publish", topic="/cmd_vel", msg={"linear": {"x": 0.4}})
            await watcher.until(
                lambda m: m["op"] == "publish" and m["msg"]["twist"]["linear"]["x"] > 0.3
            )
        await watcher.until(
            lambda m: m["op"] == "publish" and abs(m["msg"]["twist"]["linear"]["x"]) < 0.01
        )


async def test_a_second_token_of_another_client_keeps_the_subscriptions() -> None:
    more = key("viewer", GUEST, role="viewer")
    async with site(CLOSED, ROVER, more) as gateway, page(gateway, GUEST) as client:
        await client.send(op="subscribe", topic="/odom")
        await client.message("/odom")
        for _ in range(2):  # the same token again changes nothing
            await client.send(op="auth", token=OPERATOR)
            await client.status("authenticated as operator")
        client._received.clear()  # noqa: SLF001 - what the viewer got
        stamps = []
        for _ in range(20):
            stamp = (await client.message("/odom"))["header"]["stamp"]
            stamps.append((stamp["sec"], stamp["nanosec"]))
        assert len(set(stamps)) >= 19  # each once: the current value may come again
        await client.send(op="publish", topic="/cmd_vel", msg={"linear": {"x": 0.2}})
        await client.until(
            lambda m: m["op"] == "publish" and m["msg"]["twist"]["twist"]["linear"]["x"] > 0.1
        )
