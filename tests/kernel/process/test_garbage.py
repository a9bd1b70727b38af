"""Requests leave no cycles behind."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from kernel.world import World
from rcp_kernel.errors import DeviceRejected
from rcp_kernel.model import Resource
from rcp_kernel.types import quantity

pytestmark = pytest.mark.anyio
DRIVE = "/tenant/alpha/actuator/drive"
GO = "/tenant/alpha/action/go"
LOW, HIGH = "/tenant/alpha/param/low", "/tenant/alpha/param/high"
SPAN = [
    Resource(name=name, description="A bound.", value=quantity("m", le=5), atomic="span")
    for name in ("param/low", "param/high")
]
TIMES = 50
REQUESTS: dict[str, dict[str, Any]] = {
    "ping": {"type": "ping"},
    "read": {"type": "read", "path": "/tenant/alpha/param/limit"},
    "read of nothing": {"type": "read", "path": "/tenant/alpha/sensor/none"},
    "read that fails": {"type": "read", "path": "/tenant/alpha/sensor/lazy", "deadline": 0.001},
    "write": {"type": "write", "path": DRIVE, "body": {"linear": {"x": 0.2}}},
    "write of the wrong type": {"type": "write", "path": DRIVE, "body": {"linear": 1}},
    "write out of range": {"type": "write", "path": "/tenant/alpha/param/limit", "body": 9},
    "execute": {"type": "execute", "path": "/tenant/alpha/service/echo", "body": "hello"},
    "execute that fails": {"type": "execute", "path": GO, "body": 13},
    "execute of the wrong type": {"type": "execute", "path": GO, "body": "far"},
    "cancel of nothing": {"type": "cancel", "command": "cmd-none"},
    "discover of nothing": {"type": "discover", "path": "/tenant/alpha/none/*"},
    "wrong type": {"type": "shout"},
    "writes as one": {"type": "write", "body": {LOW: 1.0, HIGH: 1.0}},
    "writes as one that are wrong": {"type": "write", "body": {LOW: 9, HIGH: "x", "/a/b": 1}},
    "writes as one of no group": {"type": "write", "body": {LOW: 1.0, DRIVE: {}}},
    "batch": {"type": "batch", "body": [{"type": "read", "path": "/tenant/alpha/none"}] * 3},
}


@pytest.fixture
def uncollected() -> Iterator[Callable[[], int]]:
    """Tell how many objects of cycles there are since the last time; nothing else collects any."""
    gc.collect()
    gc.disable()
    try:
        yield gc.collect
    finally:
        gc.enable()


@pytest.mark.parametrize("request_", REQUESTS.values(), ids=list(REQUESTS))
async def test_requests_leave_no_cycles(
    world: World, request_: dict[str, Any], uncollected: Callable[[], int]
) -> None:
    client = world.client()
    world.robot.add(*SPAN)
    for _ in range(2):  # the first time makes what is kept
        uncollected()
        for _ in range(TIMES):
            await client.ask(**request_)
        left = uncollected()
    assert left < TIMES


async def test_refusals_by_an_estop_leave_no_cycles(
    world: World, uncollected: Callable[[], int]
) -> None:
    client = world.client()
    await client.ask(type="execute", path="/system/estop")
    uncollected()
    for _ in range(TIMES):
        reply = await client.ask(**REQUESTS["write"])
        assert reply["error"]["code"] == "estop_active"
    assert uncollected() < TIMES


async def test_refusals_by_the_robot_leave_no_cycles(
    world: World, uncollected: Callable[[], int]
) -> None:
    client = world.client()
    world.robot.fail_writes = TIMES + 1
    for count in range(TIMES + 1):
        if count == 1:
            uncollected()
        reply = await client.ask(type="write", path="/tenant/alpha/param/limit", body=1.0)
        assert reply["error"]["code"] == "device_rejected"
    assert uncollected() < TIMES


async def test_refusals_of_writes_as_one_leave_no_cycles(
    world: World, uncollected: Callable[[], int]
) -> None:
    async def busy(value: Any) -> Any:
        raise DeviceRejected("busy")

    client = world.client()
    world.robot.add(*SPAN)
    world.robot.takes["param/high"] = busy
    for count in range(TIMES + 1):
        if count == 1:
            uncollected()
        reply = await client.ask(**REQUESTS["writes as one"])
        assert reply["error"]["code"] == "device_rejected"
    assert uncollected() < TIMES


async def test_cancelled_commands_leave_no_cycles(
    world: World, uncollected: Callable[[], int]
) -> None:
    client = world.client()
    for _ in range(2):
        uncollected()
        for _ in range(TIMES):
            id_ = client.send(type="execute", path=GO, body=1.0)
            await world.robot.started.get()
            await client.ask(type="cancel", path=GO)
            assert (await client.final(id_))["status"] == "cancelled"
        left = uncollected()
    assert left < TIMES
