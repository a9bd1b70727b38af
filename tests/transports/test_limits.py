from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from certs import Authority
from configuration import tls
from rcp_asgi.config import AsgiConfig
from rcp_asgi.connection_limiter import ConnectionLimiter
from rcp_asgi.proxies import Proxies
from transports.raw import BOUND, Raw, answer, connected, frame, opened
from transports.robot import KEY, Site, site, until

POSE = "/rcp/v1/context/tenant/alpha/sensor/pose"
GET = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"
PUT = (
    b"PUT /rcp/v1/context/tenant/alpha/param/limit HTTP/1.1\r\nHost: localhost\r\n"
    b"Authorization: Bearer operator-of-this-test\r\n"
)
NONE = Proxies(())
asyncs = pytest.mark.anyio


@asynccontextmanager
async def from_address(gateway: Site, address: str) -> AsyncGenerator[Raw]:
    """Open a connection from another address of this machine."""
    reader, writer = await asyncio.open_connection(
        "127.0.0.1", gateway.port, local_addr=(address, 0)
    )
    try:
        yield Raw(reader, writer)
    finally:
        writer.close()


# -- seats -----------------------------------------------------------------------------------------


@asyncs
async def test_one_address_cannot_take_every_place() -> None:
    async with site(asgi="connections_per_address = 2") as gateway, AsyncExitStack() as stack:
        for _ in range(2):
            held = await stack.enter_async_context(opened(gateway))
        async with connected(gateway) as third:
            status, data = await answer(third, GET)
            assert (status, json.loads(data.partition(b"\r\n\r\n")[2])["error"]["code"]) == (
                503,
                "queue_full",
            )
        async with from_address(gateway, "127.0.0.2") as other:
            other.send(GET)
            assert (await other.reader.readline()).startswith(b"HTTP/1.1 200")
        assert gateway.server.gateway.counts.outcomes["asgi", "connection", "queue_full"] == 1
        held.send(frame(8))
        await held.ended()
        async with opened(gateway):
            pass


@asyncs
async def test_one_address_cannot_connect_faster_than_it_may() -> None:
    async with site(asgi="connection_rate = 0.1") as gateway:
        async with connected(gateway) as raw:
            raw.send(GET)
            assert (await raw.reader.readline()).startswith(b"HTTP/1.1 200")
        async with connected(gateway) as raw:
            status, data = await answer(raw, GET)
        assert status == 429
        assert b"retry-after: " in data
        assert b"rate_limited" in data


@asyncs
async def test_over_tls_one_too_many_is_cut_before_the_handshake(tmp_path: Path) -> None:
    server = Authority(tmp_path).server()
    async with site(asgi="connections = 1\n" + tls(server)) as gateway, connected(gateway) as first:
        async with connected(gateway) as second:
            await second.ended()
        first.writer.close()
        counts = gateway.server.gateway.counts.outcomes
        await until(lambda: ("asgi", "connection", "tls") in counts)
        async with connected(gateway) as third:
            third.send(b"\x16\x03\x01")
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.1):
                    await third.ended()


def test_the_limits_are_those_of_the_address_not_of_its_spelling() -> None:
    seats = ConnectionLimiter(AsgiConfig(connections_per_address=1), NONE)
    assert seats.take("192.0.2.1", 0).refusal is None
    assert seats.take("::ffff:192.0.2.1", 0).refusal is not None
    assert seats.take("2001:db8::1", 0).refusal is None
    assert seats.take("2001:db8::ffff:2", 0).refusal is not None
    assert seats.take("2001:db8:0:1::1", 0).refusal is None
    assert seats.take("fe80::1%eth0", 0).refusal is None


def test_this_machines_own_connections_are_not_limited_unless_it_is_said() -> None:
    seats = ConnectionLimiter(AsgiConfig(connections=10_000), Proxies(["192.0.2.128/25"]))
    for address, allowed in (
        ("127.0.0.1", 1_000),
        ("::1", 1_000),
        ("192.0.2.129", 1_000),
        ("192.0.2.1", 100),
    ):
        found = [seats.take(address, 0).refusal is None for _ in range(1_000)]
        assert sum(found) == allowed, address


@given(
    st.lists(
        st.tuples(st.sampled_from(["192.0.2.1", "192.0.2.2"]), st.floats(0, 1), st.booleans()),
        max_size=200,
    )
)
def test_seats_are_counted_right_and_the_rate_is_kept(
    steps: list[tuple[str, float, bool]],
) -> None:
    seats = ConnectionLimiter(
        AsgiConfig(connections=8, connections_per_address=5, connection_rate=4), NONE
    )
    now, held, made = 0.0, [], {"192.0.2.1": 0, "192.0.2.2": 0}
    for address, wait, leave in steps:
        now += wait
        if leave and held:
            seat = held.pop(0)[1]
            seat.leave()
            seat.leave()
        else:
            seat = seats.take(address, now)
            if seat.refusal is None:
                held.append((address, seat))
                made[address] += 1
            else:
                seat.leave()
        assert seats.taken == len(held) <= 8
        assert all(sum(a == one for a, _ in held) <= 5 for one in made)
        assert all(count <= 8 + now * 4 + 1e-6 for count in made.values())
        seats.sweep(now)


# -- time ------------------------------------------------------------------------------------------


@asyncs
async def test_a_body_that_stays_away_is_told_and_one_that_trickles_is_cut() -> None:
    async with site(http="body_timeout = 0.05", asgi="body_timeout = 0.3") as gateway:
        for start in (b"", b"1"):
            async with connected(gateway) as raw:
                raw.send(PUT + b"Content-Length: 100\r\n\r\n" + start)
                async with asyncio.timeout(BOUND):
                    data = await raw.reader.read(-1)  # and then the connection is cut
                assert b"deadline_exceeded" in data


@asyncs
async def test_a_body_that_trickles_on_and_on_is_cut_even_so() -> None:
    asgi = "body_timeout = 0.2"
    async with site(http="body_timeout = 0.05", asgi=asgi) as gateway, connected(gateway) as raw:
        raw.send(PUT + b"Content-Length: 100000\r\n\r\n")

        async def trickle() -> None:
            while True:
                raw.send(b"1")
                await asyncio.sleep(0.01)

        trickling = asyncio.create_task(trickle())
        await asyncio.wait_for(_gone(raw), BOUND)
        trickling.cancel()


async def _gone(raw: Raw) -> None:
    try:
        while await raw.reader.read(65_536):
            pass
    except ConnectionError:
        pass


@asyncs
async def test_blank_lines_do_not_keep_an_idle_connection() -> None:
    async with site(asgi="keep_alive = 1") as gateway, connected(gateway) as raw:
        raw.send(GET)
        await raw.reader.readuntil(b"}")
        raw.send(b"\r\n")
        async with asyncio.timeout(BOUND):
            assert await raw.reader.read(-1) == b""


@asyncs
async def test_a_websocket_that_answers_no_ping_is_cut() -> None:
    async with site(top="[limits]\nheartbeat = 0.05") as gateway, opened(gateway) as raw:
        pings = 0
        async with asyncio.timeout(BOUND):
            while head := await raw.reader.read(2):
                pings += head == b"\x89\x00"
        assert pings == 2
        await until(lambda: not gateway.server.gateway.sessions.known)


# -- requests that mean to be taken for others -----------------------------------------------------


@pytest.mark.parametrize(
    "head",
    [
        b"Content-Length: 1\r\nTransfer-Encoding: chunked\r\n",
        b"Content-Length: 1\r\nContent-Length: 2\r\n",
        b"Transfer-Encoding: chunked, identity\r\n",
        b"Transfer-Encoding : chunked\r\n",
        b"Content-Length: +1\r\n",
        b"Content-Length: 0x1\r\n",
        b"X: a\nb: c\r\n",
    ],
)
@asyncs
async def test_a_body_of_two_lengths_is_a_bad_request(gateway: Site, head: bytes) -> None:
    async with connected(gateway) as raw:
        status, _ = await answer(raw, PUT + head + b"\r\n1\r\n0\r\n\r\n" + GET)
        assert status == 400


@asyncs
async def test_a_pipelined_request_waits_for_its_turn_not_for_its_clock() -> None:
    asgi = "body_timeout = 0.1\nheader_timeout = 5"
    async with site(asgi=asgi) as gateway, connected(gateway) as raw:
        go = b"POST /rcp/v1/context/tenant/alpha/action/go?wait=5 HTTP/1.1\r\nHost: localhost\r\n"
        key = b"Authorization: Bearer " + KEY.encode() + b"\r\nContent-Length: 1\r\n\r\n"
        raw.send(go + key + b"1" + PUT + b"Content-Length: 3\r\n\r\n1")
        await gateway.robot.started.get()
        await asyncio.sleep(0.25)  # more than the second body's clock, which does not run yet
        gateway.robot.release.set()
        raw.send(b".5")
        async with asyncio.timeout(BOUND):
            assert b'"completed"' in await raw.reader.readuntil(b'"completed"')
            assert b"1.5" in await raw.reader.readuntil(b"1.5")


@asyncs
async def test_a_query_has_so_many_parameters_and_no_more(gateway: Site) -> None:
    async with httpx.AsyncClient(base_url=gateway.url) as http:
        many = "&".join(f"x-{n}={n}" for n in range(501))
        told = await http.get(f"{POSE}?{many}")
        assert (told.status_code, told.json()["error"]["code"]) == (400, "bad_request")
