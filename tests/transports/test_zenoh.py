"""A robot's gateway and a hub, joined by Zenoh over a real socket."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncGenerator, Callable
from contextlib import AsyncExitStack, asynccontextmanager, suppress

import pytest

from configuration import backend, configuration, key, table

pytest.importorskip("zenoh")

from rcp_kernel.testing import BOUND, OPERATOR, MemoryClient, Served, eventually, serve

_OPERATOR = key("operator", OPERATOR)


def _robot(port: int) -> str:
    hub = [f"tcp/127.0.0.1:{port}"]
    return configuration(
        table("transports.zenoh", gateway="r7", tenant="alpha", connect=hub),
        backend("rover", use="sim"),
        _OPERATOR,
    )


def _hub(port: int, token: str = OPERATOR) -> str:
    listen = [f"tcp/127.0.0.1:{port}"]
    fleet = backend("fleet", use="fleet", hub="h1", listen=listen, token=token)
    return configuration(fleet, _OPERATOR)


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@asynccontextmanager
async def _serving(text: str) -> AsyncGenerator[Served]:
    from rcp_kernel.config.file import parse

    async with serve(parse(text, "test")) as served:
        yield served


async def _comes(holds: Callable[[], bool], what: str) -> None:
    async def look() -> bool:
        return holds()

    await eventually(look, what)


async def _appears(client: MemoryClient, path: str) -> dict[str, object]:
    async with asyncio.timeout(BOUND):
        while True:
            found = await client.request("discover", path=path, body={"limit": 100})
            if found["status"] == "completed" and found["body"]["resources"]:
                return found["body"]["resources"][0]
            await asyncio.sleep(0.01)


@asynccontextmanager
async def _fleet() -> AsyncGenerator[tuple[Served, Served, MemoryClient]]:
    port = _free_port()
    async with AsyncExitStack() as stack:
        hub = await stack.enter_async_context(_serving(_hub(port)))
        robot = await stack.enter_async_context(_serving(_robot(port)))
        client = hub.client(OPERATOR)
        stack.push_async_callback(client.close)
        await _appears(client, "/tenant/alpha/sensor/r7/pose")
        yield hub, robot, client


async def test_a_gateway_appears_with_the_schemas_of_its_robot() -> None:
    async with _fleet() as (_, robot, client):
        local = robot.client(OPERATOR)
        theirs = await _appears(local, "/tenant/alpha/sensor/pose")
        ours = await _appears(client, "/tenant/alpha/sensor/r7/pose")
        for schemas in (theirs["schemas"], ours["schemas"]):
            schemas["value"].pop("$id")  # type: ignore[index]
        assert ours["schemas"] == theirs["schemas"]
        await local.close()


async def test_a_value_is_read_and_written_through_the_hub() -> None:
    async with _fleet() as (_, _robot_gateway, client):
        read = await client.request("read", path="/tenant/alpha/sensor/r7/pose")
        assert read["status"] == "completed", read
        wrong = await client.request(
            "write", path="/tenant/alpha/param/r7/speed_limit", body="fast"
        )
        assert wrong["error"]["code"] == "invalid_value", wrong
        done = await client.request("write", path="/tenant/alpha/param/r7/speed_limit", body=0.5)
        assert done["status"] == "completed", done
        after = await client.request("read", path="/tenant/alpha/param/r7/speed_limit")
        assert after["body"] == 0.5


async def test_a_command_reports_feedback_and_one_result() -> None:
    async with _fleet() as (_, _robot_gateway, client):
        id_ = await client.send(
            type="execute",
            path="/tenant/alpha/action/r7/move_to",
            body={"position": {"x": 0.3, "y": 0.0}},
        )
        replies = await client.replies(id_)
        assert any(reply["status"] == "in_progress" for reply in replies), replies
        assert replies[-1]["status"] == "completed", replies[-1]


async def test_a_subscription_passes_values_on() -> None:
    async with _fleet() as (_, _robot_gateway, client):
        id_ = await client.subscribe("/tenant/alpha/sensor/r7/pose")
        first, second = await client.update(id_), await client.update(id_)
        assert second["seq"] > first["seq"]


async def test_a_gateway_that_leaves_is_down_and_comes_back_by_itself() -> None:
    port = _free_port()
    async with _serving(_hub(port)) as hub:
        client = hub.client(OPERATOR)
        async with _serving(_robot(port)):
            await _appears(client, "/tenant/alpha/sensor/r7/pose")
            await _comes(lambda: hub.supervisor.state == "ready", "the backend is ready")
        await _comes(lambda: hub.supervisor.state == "down", "the backend is down")
        async with _serving(_robot(port)):
            await _comes(lambda: hub.supervisor.state == "ready", "the backend is ready")
            read = await client.request("read", path="/tenant/alpha/sensor/r7/pose")
            assert read["status"] == "completed", read
        await client.close()


async def test_a_hub_that_cannot_prove_itself_gets_nothing() -> None:
    port = _free_port()
    async with _serving(_hub(port, "nobody-knows-this-key")) as hub, _serving(_robot(port)):
        await _comes(lambda: "r7" in str(hub.supervisor.detail), "the refusal is in the status")
        client = hub.client(OPERATOR)
        found = await client.request("discover", path="/tenant/alpha/**", body={"limit": 9})
        assert not [one for one in found["body"]["resources"] if "/r7/" in one["path"]]
        await client.close()


class _Cable:
    """A TCP proxy between a robot and the router, which can be cut."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._writers: set[asyncio.StreamWriter] = set()
        self.port = 0

    @asynccontextmanager
    async def laid(self) -> AsyncGenerator[_Cable]:
        server = await asyncio.start_server(self._join, "127.0.0.1", 0)
        self.port = server.sockets[0].getsockname()[1]
        try:
            yield self
        finally:
            server.close()
            self.cut()

    def cut(self) -> None:
        for writer in self._writers:
            writer.transport.abort()
        self._writers.clear()

    async def _join(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._port)
        except OSError:
            writer.transport.abort()
            return
        self._writers |= {writer, far_writer}
        await asyncio.gather(self._pass(reader, far_writer), self._pass(far_reader, writer))

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while data := await reader.read(65_536):
                writer.write(data)
                await writer.drain()
        writer.transport.abort()


async def test_a_command_outlives_a_cut_link_and_ends_once() -> None:
    port = _free_port()
    async with (
        _serving(_hub(port)) as hub,
        _Cable(port).laid() as cable,
        _serving(_robot(cable.port)) as robot,
    ):
        client = hub.client(OPERATOR)
        await _appears(client, "/tenant/alpha/sensor/r7/pose")
        body = {"position": {"x": 1.5, "y": 0.0}}
        id_ = await client.send(type="execute", path="/tenant/alpha/action/r7/move_to", body=body)
        await client.until(lambda m: m.get("id") == id_ and m.get("status") == "in_progress")
        cable.cut()
        replies = await client.replies(id_, BOUND)
        assert replies[-1]["status"] == "completed", replies[-1]
        local = robot.client(OPERATOR)
        commands = await local.request("read", "/system/commands")
        assert len(commands["body"]) == 1, commands
        await local.close()
        await client.close()


async def test_a_robot_finds_a_hub_that_was_restarted() -> None:
    port = _free_port()
    async with AsyncExitStack() as first, AsyncExitStack() as stack:
        hub = await first.enter_async_context(_serving(_hub(port)))
        await stack.enter_async_context(_serving(_robot(port)))
        await _appears_at(hub, stack)
        await first.aclose()
        await _appears_at(await stack.enter_async_context(_serving(_hub(port))), stack)


async def _appears_at(hub: Served, stack: AsyncExitStack) -> None:
    client = hub.client(OPERATOR)
    stack.push_async_callback(client.close)
    await _appears(client, "/tenant/alpha/sensor/r7/pose")


async def test_a_lost_message_ends_the_link() -> None:
    import zenoh

    from rcp_zenoh.pipe import Pipe
    from rcp_zenoh.session import configuration, on_loop, opened

    async with opened(configuration("router"), patient=False) as session:
        reasons: list[str] = []
        taken: list[bytes | None] = []
        near = Pipe(session, "test/up", lambda: None, reasons.append)
        far = Pipe(session, "test/down", lambda: None, reasons.append)

        def take(sample: zenoh.Sample) -> None:
            if sample.payload.to_bytes() != b"two":
                taken.append(far.receive(sample))

        loop = asyncio.get_running_loop()
        subscriber = session.declare_subscriber("test/up", on_loop(loop, take))
        near.send(b"one")
        await _comes(lambda: taken == [b"one"], "the first message has arrived")
        near.send(b"two")
        near.send(b"three")
        await _comes(lambda: bool(reasons), "the loss is noticed")
        assert taken[1:] == [None]
        assert reasons == ["messages 2 to 2 were lost on the way"]
        subscriber.undeclare()
