"""Answers of many pages: the clients fetch all of them."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable

import pytest

import rcp_client
from plugins.client.gateway import BOUND, OPERATOR, Gateway
from plugins.client.test_stops import rcpctl
from rcp_kernel.errors import DeadlineExceeded
from rcp_kernel.model import Resource

pytestmark = pytest.mark.anyio
Connect = Callable[..., rcp_client.Client]
PATTERN = "/param/many/*"


@pytest.fixture
def names(gateway: Gateway) -> list[str]:
    """As many parameters as an ArduCopter has, by their paths."""
    found = [f"param/many/p{number:04}" for number in range(1348)]
    robot = gateway.robot
    robot.add(
        *(Resource(name=name, description="One of many.", value=float, live=True) for name in found)
    )
    for name in found:
        robot.say(name, 0.5)
        robot.values[name] = 0.5
    return [f"/tenant/alpha/{name}" for name in found]


@pytest.mark.parametrize("encoding", ["msgpack", "json", "cbor"])
async def test_a_read_of_a_pattern_is_whole(
    gateway: Gateway, connect: Connect, names: list[str], encoding: str
) -> None:
    async with asyncio.timeout(BOUND), connect(gateway, encoding=encoding) as client:
        found = await client.read(PATTERN)
        assert [item["path"] for item in found] == names
        reply = await client.sample(PATTERN, fresh=True)
        assert (len(reply.body), reply.truncated, reply.cursor) == (1348, False, None)
        one = await client.request({"type": "read", "path": PATTERN, "body": {"limit": 10}})
        assert (len(one.body), one.truncated) == (10, True)


async def test_pages_come_one_by_one(gateway: Gateway, connect: Connect, names: list[str]) -> None:
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        sizes = [len(items) async for items in client.pages(PATTERN, limit=500)]
        assert sizes == [500, 500, 348]
        reading = client.pages(PATTERN, limit=1, deadline=0.05)  # too little for so many
        with pytest.raises(DeadlineExceeded):
            assert [len(items) async for items in reading] == []


async def test_a_subscription_knows_every_path_that_it_reaches(
    gateway: Gateway, connect: Connect, names: list[str]
) -> None:
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        async with client.subscribe([PATTERN, "/sensor/count"]) as subscription:
            assert subscription.paths == [*names, "/tenant/alpha/sensor/count"]
            seen = set[str]()
            async for update in subscription:
                seen.add(update.path)
                if len(seen) == len(names):
                    break
        assert seen == set(names)


async def test_the_blocking_client_reads_all_of_it(gateway: Gateway, names: list[str]) -> None:
    def script() -> None:
        with rcp_client.Robot(gateway.url, token=OPERATOR, tenant="alpha") as robot:
            assert [item["path"] for item in robot.read(PATTERN)] == names
            assert [len(items) for items in robot.pages(PATTERN, limit=700)] == [700, 648]

    await asyncio.to_thread(script)


async def test_rcpctl_reads_all_of_it(gateway: Gateway, names: list[str]) -> None:
    code, out, error = await rcpctl(gateway, "read", PATTERN)
    assert (code, error) == (0, "")
    assert [json.loads(line)["path"] for line in out.splitlines()] == names
