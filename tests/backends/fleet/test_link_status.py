"""`sensor/<robot>/link` and `rcpctl fleet`: what an operator of a hub sees of gateways and links."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families
from structlog.testing import capture_logs

pytest.importorskip("zenoh")

from backends.fleet.rig import (
    appears,
    catalogue,
    hub_at,
    process_of,
    robot_at,
    serving,
)
from configuration import backend, key, listener
from plugins.client.rcpctl import BIN, BOUND
from ports import free_port
from rcp_gateway.testing import (
    OPERATOR,
    Client,
    MemoryClient,
    ScriptedRobot,
    Served,
    eventually,
    scripted,
)
from rcp_kernel.contract.version import gateway_version
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host
from rcp_zenoh.session import configuration, opened
from serving import serving as process
from steps import finished

pytestmark = pytest.mark.anyio
_LINK, _POSE = "/tenant/alpha/sensor/r7/link", "/tenant/alpha/sensor/r7/pose"
_WAYS = "sent", "received"
_LONG = 60.0  # s, on any machine


async def link(client: Client, path: str = _LINK) -> dict[str, Any]:
    """Read a link."""
    reply = await client.request("read", path)
    assert reply["status"] == "completed", reply
    return reply["body"]


async def comes(client: Client, **facts: Any) -> dict[str, Any]:
    """Wait until a link has these facts."""
    found: dict[str, Any] = {}

    async def there() -> bool:
        found.clear()
        found.update(await link(client))
        return facts.items() <= found.items()

    await eventually(there, f"the link has {facts}", _LONG)
    return found


async def test_a_link_tells_versions_delay_clock_and_bytes() -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub, serving(robot_at(port)):
        client = hub.client(OPERATOR)
        await appears(client, _POSE)
        version = gateway_version()
        await comes(client, state="ready", version=version, protocol="1", lost=0)

        async def measured() -> bool:
            return "latency" in await link(client)

        await eventually(measured, "a heartbeat has been answered", _LONG)
        found = await link(client)
        assert "detail" not in found
        assert 0 <= found["latency"] < _LONG
        assert abs(found["clock_offset"]) <= found["clock_bound"] + 0.1  # the same clock
        assert found["sent"] > 0
        assert found["links"] > 0
        assert found["received"] > found["sent"], "discovery brings more than it asks"
        shown = (await catalogue(client, _LINK))[_LINK]
        assert shown["operations"] == ["read", "subscribe"]
        (schema,) = shown["schemas"]["value"]["$defs"].values()
        fields = schema["properties"]
        assert {fields[name]["unit"] for name in ("sent", "received")} == {"By"}
        await client.close()


async def test_it_counts_the_links_of_persons_too() -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub, serving(robot_at(port)):
        client = hub.client(OPERATOR)
        await appears(client, _POSE)
        before = await comes(client, state="ready")
        await client.request("read", _POSE, body={"fresh": True})
        after = await link(client)
        assert after["sent"] > before["sent"]
        assert after["received"] > before["received"]
        await client.close()


async def test_a_subscriber_sees_a_robot_leave_and_return() -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub:
        client = hub.client(OPERATOR)
        async with serving(robot_at(port)):
            await appears(client, _POSE)
            await comes(client, state="ready")
            id_ = await client.subscribe(_LINK)
            assert (await client.update(id_))["body"]["state"] == "ready"
        while (update := await client.update(id_))["body"]["state"] == "ready":
            pass
        gone = update["body"]
        assert (gone["state"], gone["detail"]) == ("down", "its gateway cannot be reached")
        assert "latency" not in gone
        assert gone["last_seen"] <= update["timestamp"]
        async with serving(robot_at(port)):
            back = await comes(client, state="ready")
            # More than two if it said goodbye before its token went: the hub tried once more.
            assert back["links"] >= 2
            # Whichever arrives first, its last message or the end of its token.
            assert back["last_end"].startswith(("the other end closed", "the gateway is gone"))
            assert back["sent"] >= gone["sent"], "what earlier links carried counts"
        await client.close()


async def test_a_robot_that_its_gateway_cannot_reach_is_degraded() -> None:
    made: list[Host] = []

    def make(host: Host) -> ScriptedRobot:
        made.append(host)
        return ScriptedRobot(
            host, Resource(name="param/height", description="Height.", value=float)
        )

    port = free_port()
    robot = robot_at(port, backend("robot"))
    async with serving(hub_at(port)) as hub, serving(robot, scripted(make)):
        client = hub.client(OPERATOR)
        await appears(client, _LINK)
        await comes(client, state="ready")
        made[-1].report("no heartbeat", down=True)
        found = await comes(client, state="degraded")
        assert found["detail"] == "its gateway says: /tenant/alpha is down"
        made[-1].report(None)
        await comes(client, state="ready")
        await client.close()


async def test_a_gateway_of_another_major_version_is_down_with_one_sentence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub:
        client = hub.client(OPERATOR)
        with monkeypatch.context() as other:
            other.setattr("rcp_requests.handshake.VERSION", "2")
            async with serving(robot_at(port)):
                await appears(client, _LINK)
                found = await comes(client, state="down", protocol="2")
                assert found["detail"] == (
                    "its gateway speaks RCP/2 and this hub RCP/1: install versions of the gateway "
                    "that have one in common"
                )
                status = await client.request("read", "/system/status")
                (fleet,) = status["body"]["backends"]
                assert fleet["robots"]["r7"]["detail"] == found["detail"]
                assert (await client.request("read", "/system/robots"))["body"] == []
        async with serving(robot_at(port)):  # replaced by one that fits
            await appears(client, _POSE)
            await comes(client, state="ready", protocol="1")
        await client.close()


async def test_metrics_tell_of_each_robots_link() -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub:
        client = hub.client(OPERATOR)
        async with serving(robot_at(port, gateway="r7")), serving(robot_at(port, gateway="r8")):
            for robot in ("r7", "r8"):
                await appears(client, f"/tenant/alpha/sensor/{robot}/pose")

            async def measured() -> bool:
                return len(samples(hub, client, "latency_seconds")) == 2

            await eventually(measured, "a heartbeat of each has been answered", _LONG)
            sent, received = (samples(hub, client, f"{one}_bytes_total") for one in _WAYS)
            found = await link(client)
            assert 0 < sent["r7"] <= found["sent"]
            assert 0 < received["r7"] <= found["received"]
            assert samples(hub, client, "lost_total", "rcp_robot_links") == {"r7": 0, "r8": 0}
        await comes(client, state="down")
        assert "r7" not in samples(hub, client, "latency_seconds")
        assert samples(hub, client, "sent_bytes_total")["r7"] >= sent["r7"]
        await client.close()


def samples(
    hub: Served, client: MemoryClient, name: str, prefix: str = "rcp_robot_link"
) -> dict[str, float]:
    """Return the values of a metric at a scrape, by robot."""
    text = finished(hub.server.client_api.metrics(client.connection.session)).decode()
    return {
        one.labels["robot"]: one.value
        for family in text_string_to_metric_families(text)
        for one in family.samples
        if one.name == f"{prefix}_{name}"
        and (one.labels["backend"], one.labels["tenant"]) == ("fleet", "alpha")
    }


async def test_a_link_is_no_robot() -> None:
    port = free_port()
    async with serving(hub_at(port)) as hub, serving(robot_at(port)):
        client = hub.client(OPERATOR)
        await appears(client, _POSE)
        listed = (await client.request("read", "/system/robots"))["body"]
        assert [one["path"] for one in listed] == ["/tenant/alpha/r7"]
        await client.close()


async def test_a_robots_own_resource_of_that_name_does_not_replace_it() -> None:
    def make(host: Host) -> ScriptedRobot:
        names = "sensor/link", "sensor/pose"
        return ScriptedRobot(
            host, *(Resource(name=name, description="A value.", value=float) for name in names)
        )

    port = free_port()
    robot = robot_at(port, backend("robot"))
    async with serving(hub_at(port)) as hub, serving(robot, scripted(make)):
        client = hub.client(OPERATOR)
        await appears(client, _POSE)
        await comes(client, state="ready")
        shown = (await catalogue(client, _LINK))[_LINK]
        assert shown["schema_ids"]["value"].startswith("GatewayLink.")
        await client.close()


async def test_a_gateway_whose_name_cannot_be_in_a_path_is_ignored_with_a_warning() -> None:
    port = free_port()
    ends = [f"tcp/127.0.0.1:{port}"]
    with capture_logs() as logs:
        async with serving(hub_at(port)) as hub:
            async with opened(configuration("client", connect=ends), patient=False) as peer:
                token = peer.liveliness().declare_token("rcp/alpha/not a name/alive")

                async def ignored() -> bool:
                    return any(one["event"] == "fleet_gateway_ignored" for one in logs)

                await eventually(ignored, "there is a warning", _LONG)
                token.undeclare()
            client = hub.client(OPERATOR)
            async with serving(robot_at(port)):
                await appears(client, _POSE)
            await client.close()


# -- rcpctl ----------------------------------------------------------------------------------------


async def rcpctl(url: str, *arguments: str) -> tuple[int, str, str]:
    """Run it, without standing in the way of the gateways in this process."""
    process = await asyncio.create_subprocess_exec(
        BIN / "rcpctl", "--url", url, "--token", OPERATOR, "fleet", *arguments,
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    async with asyncio.timeout(BOUND):
        out, err = await process.communicate()
    return process.returncode or 0, out.decode(), err.decode()


async def listed(url: str, *states: tuple[str, str]) -> list[dict[str, Any]]:
    """Return its rows once the robots are in these states, in this order."""
    rows: list[dict[str, Any]] = []

    async def there() -> bool:
        code, out, _ = await rcpctl(url, "--json")
        assert code == 0
        rows[:] = [json.loads(line) for line in out.splitlines()]
        return [(row["robot"], row["state"]) for row in rows] == list(states)

    await eventually(there, f"the robots are {states}", _LONG)
    return rows


async def test_rcpctl_lists_the_robots_with_problems_first(tmp_path: Path) -> None:
    port, version = free_port(), gateway_version()
    first, last = "/tenant/alpha/a1", "/tenant/alpha/z9"
    ends = [f"tcp/127.0.0.1:{port}"]
    fleet = backend("fleet", use="fleet", hub="h1", token=OPERATOR, listen=ends)
    hub = listener(grace=0.1) + fleet + key("operator", OPERATOR)
    with process(tmp_path / "hub.toml", hub) as url:
        assert await rcpctl(url) == (0, "", "No robot that you may see has dialled in yet.\n")
        async with serving(robot_at(port, gateway="a1")):
            async with serving(robot_at(port, gateway="z9")):
                await listed(url, (first, "ready"), (last, "ready"))
            gone, here = await listed(url, (last, "down"), (first, "ready"))
            assert gone["detail"] == "its gateway cannot be reached"
            assert (here["version"], here["protocol"]) == (version, "1")
            code, out, err = await rcpctl(url, "--text")
        assert (code, err) == (0, "")
        problem, empty, *table = out.splitlines()
        assert (problem, empty) == (f"{last} is down: its gateway cannot be reached", "")
        assert [line.split()[:4] for line in table] == [
            ["ROBOT", "STATE", "GATEWAY", "RCP"],
            [last, "down", version, "1"],
            [first, "ready", version, "1"],
        ]


_WRONG_CLOCK = """
import time
_time, _time_ns = time.time, time.time_ns
time.time = lambda: _time() + 90.0
time.time_ns = lambda: _time_ns() + 90_000_000_000
"""


async def test_a_robot_whose_clock_is_wrong_shows_by_how_much(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(_WRONG_CLOCK)
    port = free_port()
    async with (
        serving(hub_at(port)) as hub,
        serving(robot_at(port, gateway="r8")),
        process_of(tmp_path / "r7.toml", robot_at(port), {"PYTHONPATH": str(tmp_path)}),
    ):
        client = hub.client(OPERATOR)
        other = _LINK.replace("r7", "r8")
        await appears(client, _POSE)
        await appears(client, other)

        async def measured() -> bool:
            told = [await link(client), await link(client, other)]
            return all("clock_offset" in one for one in told)

        await eventually(measured, "both clocks have been compared", _LONG)
        wrong, right = await link(client), await link(client, other)
        assert abs(wrong["clock_offset"] - 90.0) <= wrong["clock_bound"] + 0.1, wrong
        assert abs(right["clock_offset"]) <= right["clock_bound"] + 0.1, right
        assert wrong["state"] == "ready"  # nothing else depends on it: leases, deadlines
        done = await client.request("write", "/tenant/alpha/param/r7/speed_limit", body=0.5)
        assert done["status"] == "completed", done
        await client.close()
