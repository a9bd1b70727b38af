"""Values pass a hub as the robot encoded them, with the robot's numbers and times."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import pytest

pytest.importorskip("zenoh")

from backends.fleet.rig import appears, hub_at, robot_at, serving
from configuration import backend
from ports import free_port
from rcp_fleet.values import RobotNumbers, RobotValue
from rcp_gateway.testing import OPERATOR, Client, ScriptedRobot, Served, eventually, scripted
from rcp_kernel.model import Resource
from rcp_kernel.spi import Encoded, Host
from rcp_kernel.types import quantity
from rcp_kernel.values import Encoding
from transports.cable import Cable

HEIGHT, IMAGE = "sensor/height", "param/image"
OWN = backend("robot")


class Image(msgspec.Struct, frozen=True):
    """Bytes, a number that may be none, and a long integer: what JSON writes otherwise."""

    data: bytes
    id: int
    gain: quantity("1") = 1.0  # pyright: ignore[reportInvalidTypeForm]


class Lift:
    """A robot that publishes what a test says, behind a gateway, a cable, and a hub."""

    def __init__(self) -> None:
        self.robot: ScriptedRobot
        self.hub: Served
        self.served: Served
        self.cable: Cable

    def make(self, host: Host) -> ScriptedRobot:
        """Make the robot."""
        self.robot = ScriptedRobot(
            host,
            Resource(name=HEIGHT, description="Height.", value=quantity("m")),
            Resource(name=IMAGE, description="Image.", value=Image),
            values={HEIGHT: 0.0, IMAGE: Image(b"", 1)},
        )
        return self.robot

    @asynccontextmanager
    async def running(self) -> AsyncGenerator[Client]:
        """Yield a client of the hub, once it shows the robot."""
        port = free_port()
        async with (
            serving(hub_at(port)) as self.hub,
            Cable(port).laid() as self.cable,
            serving(robot_at(self.cable.port, OWN), scripted(self.make)) as self.served,
        ):
            client = self.hub.client(OPERATOR, Encoding.MSGPACK)
            await appears(client, f"/tenant/alpha/{hub_name(HEIGHT)}")
            yield client
            await client.close()

    async def watched(self) -> None:
        """Wait until the hub's subscription has reached the robot's gateway."""
        entry = self.served.supervisor.entries[HEIGHT]

        async def listens() -> bool:
            return bool(entry.listeners)

        await eventually(listens, "the hub's subscription is there", 30.0)


def hub_name(name: str) -> str:
    """Return the hub's name of a resource."""
    return name.replace("/", "/r7/")


async def test_a_value_is_not_decoded_on_its_way_through_the_hub(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    decoded: list[bytes] = []
    decode = RobotValue.decode

    def noted(value: RobotValue) -> Any:
        decoded.append(value.data)
        return decode(value)

    monkeypatch.setattr(RobotValue, "decode", noted)
    lift = Lift()
    async with lift.running() as client:
        for _ in range(7):  # a number that differs from the hub's own count
            lift.robot.measure(HEIGHT, 0.5)
        id_ = await client.subscribe(f"/tenant/alpha/{hub_name(HEIGHT)}")
        await lift.watched()
        source = 1_700_000_000_123_456_789
        lift.robot.measure(HEIGHT, 1.25, source)
        while (update := await client.update(id_))["body"] != 1.25:
            pass
        own = lift.served.supervisor.entries[HEIGHT].latest
        assert own is not None
        assert (update["seq"], update["timestamp"]) == (own.seq, own.time)
        assert own.timestamp == source
        assert not decoded
        texts = [lift.hub.client(OPERATOR) for _ in range(2)]
        ids = [await one.subscribe(f"/tenant/alpha/{hub_name(HEIGHT)}") for one in texts]
        assert [(await t.update(i))["body"] for t, i in zip(texts, ids, strict=True)] == [1.25] * 2
        assert len(decoded) == 1
        for one in texts:
            await one.close()


async def test_a_subscription_catches_up_from_the_robot_after_a_cut() -> None:
    lift = Lift()
    async with lift.running() as client:
        path = f"/tenant/alpha/{hub_name(HEIGHT)}"
        id_ = await client.subscribe(path, qos={"reliability": "reliable"})
        await lift.watched()
        lift.robot.measure(HEIGHT, 1.0)
        first = await client.update(id_)
        while first["body"] != 1.0:
            first = await client.update(id_)
        lift.cable.cut()
        for number in range(20):  # in one turn of the loop: the link cannot be back yet
            lift.robot.measure(HEIGHT, 2.0 + number)
        async with asyncio.timeout(60.0):
            got = [await client.update(id_, 60.0) for _ in range(20)]
        assert [one["body"] for one in got] == [2.0 + number for number in range(20)]
        assert [one["seq"] for one in got] == [first["seq"] + 1 + n for n in range(20)]


async def test_what_json_writes_otherwise_reaches_the_robot_as_it_is() -> None:
    lift = Lift()
    async with lift.running():
        client, path = lift.hub.client(OPERATOR), f"/tenant/alpha/{hub_name(IMAGE)}"
        body = {"data": "AAEC", "id": "9007199254740993", "gain": 2}
        done = await client.request("write", path=path, body=body)
        assert done["status"] == "completed", done
        assert lift.robot.values[IMAGE] == Image(b"\x00\x01\x02", 9007199254740993, 2.0)
        read = await client.request("read", path=path)
        assert read["body"] == {**body, "gain": 2.0}
        await client.close()


def test_numbers_go_on_when_a_robot_begins_anew() -> None:
    numbers = RobotNumbers()
    assert [numbers.of("a", seq, seq) for seq in (5, 6)] == [5, 6]
    assert numbers.of("a", 5, 5) == 5  # the same sample on another way
    assert [numbers.of("a", seq, 100 + seq) for seq in (1, 2)] == [7, 8]
    assert numbers.of("b", 3, 1) == 3
    numbers.restarted()  # with a clock that is behind the one before
    assert [numbers.of("a", seq, seq) for seq in (1, 2, 2)] == [9, 10, 10]
    assert numbers.of("b", 4, 0) == 4


def test_a_value_of_a_robot_is_one_that_the_kernel_passes_on() -> None:
    assert isinstance(RobotValue(b"\xc0", 1, 1), Encoded)
