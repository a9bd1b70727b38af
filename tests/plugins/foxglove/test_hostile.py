"""Clients that are wrong, hostile, slow or gone: told why, kept, and harmless to everybody else."""

from __future__ import annotations

import asyncio
import json
import random
import struct
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any

import pytest
from websockets.asyncio.client import connect
from websockets.typing import Subprotocol

import rcp_asgi.socket
from plugins.foxglove.rig import OPERATOR, Site, site
from plugins.foxglove.viewer import BOUND, Viewer, viewing
from rcp_foxglove import requests
from rcp_gateway.testing import eventually
from rcp_kernel.model import Resource
from rcp_kernel.sessions.outbox import Outbox

pytestmark = pytest.mark.anyio
WRONG: dict[str, str | bytes] = {
    "no JSON": "hello",
    "an empty text": "",
    "an empty binary message": b"",
    "a list": "[]",
    "no op": "{}",
    "an op of no kind": '{"op": 7}',
    "an unknown op": '{"op": "launch"}',
    "a missing field": '{"op": "subscribe"}',
    "a wrong type": '{"op": "subscribe", "subscriptions": 5}',
    "a number below zero": '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
    "a number too large": '{"op": "unsubscribe", "subscriptionIds": [99999999999]}',
    "a fraction": '{"op": "unsubscribe", "subscriptionIds": [1.5]}',
    "deep nesting": '{"op": "setParameters", "parameters": ' + "[" * 5000 + "]" * 5000 + "}",
    "half a text": '{"op": "subscribe", "subscriptions": [{"id": 1, ',
    "an opcode of nothing": b"\x09abc",
    "half a message": b"\x01\x00",
    "half a call": b"\x02\x00\x00\x00\x00\x01",
    "a call with an endless encoding": struct.pack("<BIII", 2, 1, 1, 2**32 - 1) + b"json",
    "a message on no channel": struct.pack("<BI", 1, 77) + b"{}",
    "an end of no subscription": '{"op": "unsubscribe", "subscriptionIds": [12]}',
    "an end of no channel": '{"op": "unadvertise", "channelIds": [12]}',
}


@pytest.mark.parametrize("what", WRONG)
async def test_what_is_wrong_is_told_and_the_connection_kept(
    what: str, gateway: Site, viewer: Viewer
) -> None:
    await viewer.socket.send(WRONG[what])
    assert (await viewer.op("status"))["message"]
    await viewer.subscribe("/sensor/level")
    assert (await viewer.message())[1] == b"1.25"


async def test_a_client_with_too_much_under_way_is_not_read_until_some_of_it_is_done(
    gateway: Site, viewer: Viewer, monkeypatch: pytest.MonkeyPatch
) -> None:
    paused, release = asyncio.Event(), asyncio.Event()
    usual = rcp_asgi.socket.Socket.pause_reading

    def pause_reading(self: rcp_asgi.socket.Socket) -> None:
        usual(self)
        paused.set()

    async def slow(value: object) -> None:
        await release.wait()

    monkeypatch.setattr(rcp_asgi.socket.Socket, "pause_reading", pause_reading)
    monkeypatch.setattr(requests, "_TASKS", 4)
    gateway.robot.takes["param/limit"] = slow
    for number in range(4):  # one by one, so that none of them ends a turn
        wish = [{"name": "/param/limit", "value": float(number % 2)}]
        await viewer.send("setParameters", parameters=wish, id=f"{number}")
    async with asyncio.timeout(BOUND):
        await paused.wait()
    await viewer.send("getParameters", parameterNames=["/param/limit"], id="after")
    release.set()
    await viewer.op("parameterValues", id="after")


async def test_ten_megabytes_are_told_and_the_connection_kept() -> None:
    async with (
        site(more="[limits]\nmessage = 8388608\n") as made,
        viewing(made.url, OPERATOR) as viewer,
    ):
        await viewer.socket.send(b"\x01" + bytes(10_000_000))
        assert "10000001 bytes" in (await viewer.op("status"))["message"]
        await viewer.socket.send(b"[" + b"1," * 2_000_000 + b"1]")
        assert "operation of" in (await viewer.op("status"))["message"]
        await viewer.subscribe("/sensor/level")
        await viewer.message()


async def test_ten_megabytes_that_are_published_hold_nobody_up(
    gateway: Site, viewer: Viewer
) -> None:
    channel = {"id": 3, "topic": "/cmd_vel", "encoding": "json"}
    await viewer.send("advertise", channels=[channel])
    await viewer.publish(3, b"[" + b"1," * 5_000_000 + b"1]")
    await viewer.until(lambda: "publish:/cmd_vel" in viewer.statuses)
    assert not gateway.robot.writes


async def test_what_a_client_asks_for_and_does_not_read_does_not_pile_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked, most = asyncio.Event(), 0
    begin, put = requests.Requests.begin, Outbox.put

    def count(self: Outbox, data: bytes) -> None:
        nonlocal most
        put(self, data)
        most = max(most, self.waiting)

    def note(self: requests.Requests, work: Coroutine[Any, Any, None]) -> None:
        async def noted() -> None:
            await work
            asked.set()

        begin(self, noted())

    async with site(more="[limits]\nqueue_bytes = 1048576\n") as made:
        many = [f"param/many/p{number}" for number in range(40)]
        made.robot.add(*(Resource(name=n, description="A text.", value=str) for n in many))
        for name in many:
            made.robot.measure(name, "a" * 200_000)
        monkeypatch.setattr(Outbox, "put", count)
        async with connect(
            made.url.replace("http", "ws", 1),
            subprotocols=[Subprotocol("foxglove.sdk.v1")],
            additional_headers={"Authorization": f"Bearer {OPERATOR}"},
            proxy=None,
            max_queue=1,
        ) as socket:
            await socket.recv()
            monkeypatch.setattr(requests.Requests, "begin", note)
            names = [f"/{name}" for name in many] * 5
            await socket.send(json.dumps({"op": "getParameters", "parameterNames": names}))
            async with asyncio.timeout(BOUND):
                await asked.wait()
            asked.clear()
            late = {"op": "getParameters", "parameterNames": names[:2], "id": "late"}
            await socket.send(json.dumps(late))
            async with asyncio.timeout(BOUND):
                await asked.wait()  # it has not read yet
                while (answer := json.loads(await socket.recv())).get("id") != "late":
                    pass
    assert answer["parameters"] == []
    assert 200_000 < most < 2 * 1_048_576


async def test_garbage_of_every_kind_closes_nothing(gateway: Site, viewer: Viewer) -> None:
    chance = random.Random(7)
    for _ in range(500):
        data = chance.randbytes(chance.randrange(40))
        await viewer.socket.send(data)
        await viewer.socket.send(struct.pack("<B", chance.choice((1, 2))) + data)
    status = await viewer.until(
        lambda: [m for m in viewer.texts if "further messages" in m.get("message", "")]
    )
    assert status
    assert len([m for m in viewer.texts if m["op"] == "status"]) < 400
    await viewer.subscribe("/sensor/level")
    await viewer.message()


async def test_a_flood_of_operations_delays_nobody_for_long(gateway: Site, viewer: Viewer) -> None:
    async with viewing(gateway.url, OPERATOR) as other:
        await other.subscribe("/sensor/level")
        await other.message()
        names = json.dumps({"op": "getParameters", "parameterNames": []})

        async def flood() -> None:
            for _ in range(3000):
                await viewer.socket.send(names)

        flooding = asyncio.create_task(flood())
        for n in range(10):
            gateway.robot.measure("sensor/level", n + 0.25)
            wanted = f"{n + 0.25}".encode()
            await other.until(lambda w=wanted: any(f[13:] == w for f in other.frames))
        flooding.cancel()
        with suppress(asyncio.CancelledError):
            await flooding


async def test_a_slow_viewer_delays_only_itself_and_is_told_what_it_missed(
    gateway: Site, viewer: Viewer
) -> None:
    async with viewing(gateway.url, OPERATOR, ping_interval=None) as slow:
        gateway.robot.measure("sensor/map", b"first")
        for one in (viewer, slow):
            await one.subscribe("/sensor/map")
            await one.message()
        slow.socket.transport.pause_reading()  # it reads no more
        for n in range(60):
            gateway.robot.measure("sensor/map", bytes([n]) * 1_000_000)
            await viewer.message()
        slow.socket.transport.resume_reading()
        gateway.robot.measure("sensor/map", b"last")
        await slow.until(lambda: "slow" in slow.statuses)
        assert "/sensor/map" in slow.statuses["slow"]["message"]
        await slow.until(lambda: any(f[13:] == b'"bGFzdA=="' for f in slow.frames))
        await slow.until(lambda: "slow" not in slow.statuses)
        assert len(slow.frames) < 40


async def test_a_viewer_that_vanishes_leaves_nothing(gateway: Site) -> None:
    sessions = gateway.server.gateway.sessions.known
    before = len(sessions)
    for _ in range(5):
        async with viewing(gateway.url, OPERATOR) as viewer:
            await viewer.subscribe("/sensor/level")
            await viewer.message()
            viewer.socket.transport.abort()

    async def gone() -> bool:
        return len(sessions) == before

    await eventually(gone, "their sessions have ended")
