"""Every kind of link carries a vehicle, several vehicles are robots of their own, keys keep others out."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any

import httpx
import pytest
import websockets

import rcp_mavlink
from backends.mavlink.flying import agrees, airborne, twin
from configuration import backend, key, listener
from ports import free_port
from rcp_gateway.testing import eventually, serve
from rcp_gateway.testing._serve import OPERATOR, serve_backend
from rcp_kernel.config.file import parse
from rcp_mavlink.config import LinkSpec, MavlinkConfig
from rcp_mavlink.dialect import dialect
from rcp_mavlink.frames import Framer
from rcp_mavlink.links import Link
from rcp_mavlink.signing import key_of
from rcp_mavlink_sim.modes import Mode

KIND = next(iter(rcp_mavlink.rcp_backends()))


@asynccontextmanager
async def reading(*links: str, **config: Any) -> AsyncGenerator[Any]:
    async with serve_backend(KIND, {"links": list(links), "params": [], **config}) as served:
        yield served


async def mode_of(served: Any, name: str = "sensor/mode") -> str:
    await eventually(lambda: _is(bool(served.lives)), "it is heard")
    reply = await served.client(OPERATOR).request("read", f"/tenant/t/{name}")
    assert reply["status"] == "completed", reply
    return reply["body"]


@pytest.mark.parametrize("kind", ["udpin", "udpout", "tcp"])
async def test_a_vehicle_is_heard_over(kind: str) -> None:
    if kind == "udpin":
        port = free_port(socket.SOCK_DGRAM)
        async with reading(f"udpin:127.0.0.1:{port}") as served, twin(f"udpout:127.0.0.1:{port}"):
            await eventually(lambda: _is(bool(served.lives)), "it is heard")
            assert await mode_of(served) == "GUIDED"
        return
    own = "udpin" if kind == "udpout" else "tcpin"
    async with AsyncExitStack() as stack:
        running = await stack.enter_async_context(twin(f"{own}:127.0.0.1:0"))
        link = f"{kind}:127.0.0.1:{running.ports[0][1]}"
        served = await stack.enter_async_context(reading(link))
        assert await mode_of(served) == "GUIDED"


async def test_a_connection_that_is_dropped_is_made_again() -> None:
    async with twin("tcpin:127.0.0.1:0") as running:
        link = f"tcp:127.0.0.1:{running.ports[0][1]}"
        async with reading(link, silence=1.5) as served:
            assert await mode_of(served) == "GUIDED"
            for drop in list(running.on_reboot):
                drop()
            await eventually(lambda: _is(len(running.peers) == 1), "it calls again")
            running.vehicle.flight.set_mode(Mode.LOITER)

            async def seen() -> bool:
                return await mode_of(served) == "LOITER"

            await eventually(seen, "it hears again")


async def test_a_vehicle_is_heard_over_a_serial_line() -> None:
    ours, theirs = os.openpty()
    os.set_blocking(ours, False)
    try:
        async with twin() as running:
            peer = running.join(lambda frame: _written(ours, frame))
            loop = asyncio.get_running_loop()
            loop.add_reader(ours, lambda: peer.feed(os.read(ours, 4096)))
            try:
                async with reading(f"serial:{os.ttyname(theirs)}:115200") as served:
                    assert await mode_of(served) == "GUIDED"
            finally:
                loop.remove_reader(ours)
    finally:
        os.close(ours)
        os.close(theirs)


def _written(fd: int, frame: bytes) -> None:
    try:
        os.write(fd, frame)
    except (BlockingIOError, OSError):
        return  # nobody reads at the other end, or not fast enough: a line loses


async def test_vehicles_of_one_link_are_robots_of_their_own() -> None:
    port = free_port(socket.SOCK_DGRAM)
    async with AsyncExitStack() as stack:
        for system in (1, 2, 3):
            await stack.enter_async_context(twin(f"udpout:127.0.0.1:{port}", system=system))
        served = await stack.enter_async_context(
            reading(f"udpin:127.0.0.1:{port}", discover=True, names={"2": "scout"})
        )

        async def all_there() -> bool:
            if not served.lives:
                return False
            return {"vehicle1", "scout", "vehicle3"} == set(served.life.backend.robots)

        await eventually(all_there, "all are found")
        client = served.client(OPERATOR)
        reply = await client.request(
            "execute", "/tenant/t/action/scout/set_mode", body={"mode": "LOITER"}
        )
        assert reply["status"] == "completed", reply
        assert await mode_of(served, "sensor/scout/mode") == "LOITER"
        assert await mode_of(served, "sensor/vehicle1/mode") == "GUIDED"


async def test_with_a_key_only_who_has_it_is_heard() -> None:
    async with twin(key=key_of("ours")) as running:
        link = f"udpout:127.0.0.1:{running.ports[0][1]}"
        async with reading(link, key="ours") as served:
            assert await mode_of(served) == "GUIDED"
        async with reading(link, key="theirs", connect=1.5) as served:
            assert not served.lives
            message = "not signed with `key`"
            await eventually(
                lambda: _is(message in (served.supervisor.detail or "")), "it says why"
            )


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("[::]", "0.0.0.0"),
        ("[::]", "127.0.0.1"),
        ("[::]", "[::1]"),
        ("[::1]", "127.0.0.1"),
        ("0.0.0.0", "127.0.0.1"),
        ("127.0.0.1", "127.0.0.2"),
        ("127.0.0.1", "localhost"),
        ("Localhost", "0.0.0.0"),
        ("127.0.0.2", "localhost"),
    ],
)
async def test_links_are_said_to_clash_if_both_cannot_be_open(
    kind: str, one: str, other: str
) -> None:
    async with AsyncExitStack() as stack:
        first = await _listening(stack, f"{kind}:{one}:0")
        texts = [f"{kind}:{host}:{first.port}" for host in (one, other)]
        opened = True
        try:
            await _listening(stack, texts[1])
        except OSError:
            opened = False
    exclusive = KIND.exclusive
    assert exclusive is not None
    said = [*exclusive(MavlinkConfig(links=tuple(texts)))]
    assert said[0].overlaps(said[1]) is not opened
    assert said[1].overlaps(said[0]) is not opened


async def _listening(stack: AsyncExitStack, text: str) -> Link:
    messages = dialect("ardupilotmega")
    link = Link(0, text, lambda: Framer(messages, None), lambda *_: None)
    await link.open()
    stack.push_async_callback(link.close)
    return link


@pytest.mark.parametrize(
    "text", ["udp:1:2", "udpin:localhost", "tcp:h:99999", "serial:ttyS0", "udpin:h:1:2"]
)
def test_what_is_no_link_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is not a link"):
        LinkSpec.of(text)


async def test_http_and_websocket_fly_it() -> None:
    async with twin() as running:
        airborne(running.vehicle)
        text = (
            listener()
            + backend(
                tenant="t",
                use="mavlink",
                links=[f"udpout:127.0.0.1:{running.ports[0][1]}"],
                params=[],
            )
            + key("pilot", "the-key-of-the-pilot-0123456789", role="operator")
        )
        headers = {"Authorization": "Bearer the-key-of-the-pilot-0123456789"}
        async with serve(parse(text, "test"), KIND) as served:
            url = next(f["url"] for f in served.server.status.transports if "url" in f)
            await agrees(served.life.backend, running.vehicle)
            async with httpx.AsyncClient(base_url=f"{url}/rcp/v1", headers=headers) as http:
                moved = await http.post(
                    "/context/tenant/t/action/move_to?wait=30", json={"north": 15.0}, timeout=40
                )
                assert moved.status_code == 200, moved.text
                assert moved.json()["status"] == "completed"
            socket_url = url.replace("http", "ws") + "/rcp/v1/ws"
            async with websockets.connect(socket_url, additional_headers=headers) as ws:
                await ws.send('{"type":"execute","id":"r","path":"/tenant/t/action/rtl"}')
                async with asyncio.timeout(60):
                    while '"completed"' not in (said := str(await ws.recv())):
                        assert '"failed"' not in said, said
        assert running.vehicle.body.landed


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
