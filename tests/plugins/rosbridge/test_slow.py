"""A client that does not read delays only itself, and is told what it missed."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import msgspec
import pytest

from plugins.rosbridge.rig import OPEN, ROBOT, page, site
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend, Host
from rcp_rosbridge import dialects


class _NoOptions(msgspec.Struct):
    pass


class _Robot(BaseBackend):
    """Publishes what a test says."""

    def __init__(self, host: Host) -> None:
        self.host = host
        host.declare(
            Resource(name="sensor/text", description="A text.", value=str, live=True),
            Resource(name="sensor/count", description="A count.", value=int, live=True),
        )


@asynccontextmanager
async def _open(_: _NoOptions, host: Host) -> AsyncGenerator[_Robot]:
    yield _Robot(host)


async def test_a_client_that_does_not_read_is_told_what_it_missed() -> None:
    kind = BackendKind("robot", _NoOptions, _open)
    async with (
        site(OPEN, ROBOT, kinds=(kind,)) as gateway,
        page(gateway) as quick,
        page(gateway, max_queue=1) as slow,
    ):
        robot = gateway.served.life.backend
        assert isinstance(robot, _Robot)
        for client in (quick, slow):
            await client.send(op="subscribe", topic="/sensor/text", queue_length=4)
            await client.send(op="subscribe", topic="/sensor/count", queue_length=4)
            await client.values("/rosapi/get_time")
        # The slow client reads nothing meanwhile, which the quick one does not notice.
        for number in range(300):
            robot.host.publish("sensor/text", "x" * 100_000 + str(number))
            robot.host.publish("sensor/count", number)
            await quick.until(
                lambda m, n=number: m.get("topic") == "/sensor/count" and m["msg"]["data"] == n
            )
            quick._received.clear()  # noqa: SLF001 - the texts
        told = await slow.status("were skipped")
        assert told["level"] == "warning"
        assert "/sensor/" in told["msg"]
        await slow.until(lambda m: m.get("topic") == "/sensor/count" and m["msg"]["data"] == 299)


async def test_what_a_dead_client_leaves_is_bounded() -> None:
    kind = BackendKind("robot", _NoOptions, _open)
    async with site(OPEN, ROBOT, kinds=(kind,)) as gateway, page(gateway, max_queue=1) as slow:
        robot = gateway.served.life.backend
        assert isinstance(robot, _Robot)
        await slow.send(op="subscribe", topic="/sensor/text")
        await slow.values("/rosapi/get_time")
        session = next(iter(gateway.kernel.sessions.known.values()))
        for _ in range(50):
            # Calls whose responses nobody reads.
            await slow.socket.send(
                json.dumps({"op": "call_service", "service": "/rosapi/topics_and_raw_types"})
            )
            robot.host.publish("sensor/text", "x" * 1_000_000)
            await asyncio.sleep(0)
        outbox = session.connection.outbox
        assert outbox.waiting < 4_000_000


async def test_a_message_is_written_once_for_all_clients(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    whole = dialects._Messages._json  # noqa: SLF001 - the place where messages are written

    def counted(self: Any, sample: Any) -> bytes:
        made.append(sample.seq)
        return whole(self, sample)

    monkeypatch.setattr(dialects._Messages, "_json", counted)  # noqa: SLF001
    kind = BackendKind("robot", _NoOptions, _open)
    async with site(OPEN, ROBOT, kinds=(kind,)) as gateway, AsyncExitStack() as stack:
        robot = gateway.served.life.backend
        assert isinstance(robot, _Robot)
        robot.host.publish("sensor/count", 0)
        pages = [await stack.enter_async_context(page(gateway)) for _ in range(4)]
        for client in pages:
            await client.send(op="subscribe", topic="/sensor/count", queue_length=8)
            await client.message("/sensor/count")
        made.clear()
        for number in range(1, 21):
            robot.host.publish("sensor/count", number)
            for client in pages:
                assert (await client.message("/sensor/count"))["data"] == number
        assert len(made) == 20
