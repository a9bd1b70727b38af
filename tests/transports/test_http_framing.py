"""What is no request, or could be two: answered with a typed error, and the connection closed."""

from __future__ import annotations

import asyncio
import json
from random import Random
from time import thread_time

import httpx
import pytest

from rcp_asgi.http import HttpProtocol
from transports.raw import answer, connected, handshake
from transports.robot import BOUND, KEY, Site, site, until

pytestmark = pytest.mark.anyio
POSE = b"/rcp/v1/context/tenant/alpha/sensor/pose"
HOST = b"Host: localhost\r\n"
PING = b'{"type":"ping"}'
CHUNKED = b"Transfer-Encoding: chunked\r\n\r\n"


def post(fields: bytes, body: bytes = b"", version: bytes = b"1.1") -> bytes:
    return b"POST /rcp/v1/messages HTTP/" + version + b"\r\n" + HOST + fields + body


def get(fields: bytes = HOST, target: bytes = POSE, version: bytes = b"1.1") -> bytes:
    return b"GET " + target + b" HTTP/" + version + b"\r\n" + fields + b"\r\n"


async def refused(gateway: Site, request: bytes) -> tuple[int, str]:
    """Send a request that ends its connection; returns status and code of the error."""
    async with connected(gateway) as raw, asyncio.timeout(BOUND):
        status, data = await answer(raw, request)
    head, _, body = data.partition(b"\r\n\r\n")
    assert b"connection: close" in head.lower(), data
    error = json.loads(body)["error"]
    assert error["remedy"]
    return status, error["code"]


# -- where the body ends ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        (post(b"Transfer-Encoding: gzip\r\n\r\n"), 501),
        (post(b"Transfer-Encoding: xchunked\r\n\r\n", b"f\r\n" + PING + b"\r\n0\r\n\r\n"), 501),
        (post(b"Transfer-Encoding: identity\r\n\r\n"), 501),
        (post(b"Transfer-Encoding: gzip, chunked\r\n\r\n", b"5\r\nhello\r\n0\r\n\r\n"), 501),
        (post(b"Transfer-Encoding: chunked, gzip\r\n\r\n", b"0\r\n\r\n"), 400),
        (post(b"Transfer-Encoding: chunked, chunked\r\n\r\n", b"0\r\n\r\n"), 400),
        (post(b"Transfer-Encoding: \x0bchunked\r\n\r\n", b"0\r\n\r\n"), 400),
        (post(b"Content-Length: 15\r\n" + CHUNKED, b"f\r\n" + PING + b"\r\n0\r\n\r\n"), 400),
        (post(b"Transfer-Encoding: chunked\r\nContent-Length: 15\r\n\r\n", PING), 400),
        (post(b"Content-Length: 15\r\nContent-Length: 16\r\n\r\n", PING), 400),
        (post(b"Content-Length: +15\r\n\r\n", PING), 400),
        (post(CHUNKED, b"f\r\n" + PING + b"\r\n0\r\n\r\n", b"1.0"), 400),
        (post(CHUNKED, b"xyz\r\n" + PING), 400),
        (post(CHUNKED, b"-1\r\n" + PING), 400),
        (post(CHUNKED, b"0xf\r\n" + PING), 400),
        (post(CHUNKED, b"f" * 18 + b"\r\n" + PING), 400),
        (post(CHUNKED, b"f\r\n" + PING + b"\r\nzz\r\n"), 400),
        (post(CHUNKED, b"5\r\nhelloXX0\r\n\r\n"), 400),
        (post(CHUNKED, b"f\n" + PING + b"\n0\n\n"), 400),
    ],
)
async def test_a_body_whose_end_is_in_doubt_is_refused(
    gateway: Site, request_: bytes, status: int
) -> None:
    found, code = await refused(gateway, request_)
    assert (found, code) == (status, "not_implemented" if status == 501 else "bad_request")


async def test_a_bad_chunk_that_comes_late_is_answered_too(gateway: Site) -> None:
    async with connected(gateway) as raw:
        raw.send(post(CHUNKED, b"5\r\nhello\r\n"))
        await asyncio.sleep(0)
        status, data = await answer(raw, b"nothing\r\n")
    assert (status, b"bad_request" in data) == (400, True)


async def test_half_a_value_reaches_no_robot(gateway: Site, http: httpx.AsyncClient) -> None:
    taken: list[object] = []

    async def write(name: str, value: object) -> None:
        taken.append(value)

    gateway.robot.write = write  # type: ignore[method-assign, assignment]
    head = f"PUT /rcp/v1/context/tenant/alpha/param/limit HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {KEY}\r\n"
    for whole in (head + "Content-Length: 3\r\n\r\n2", head + "Transfer-Encoding: chunked\r\n\r\n1\r\n2\r\n"):  # fmt: skip
        async with connected(gateway) as raw:
            raw.send(whole.encode())
            await raw.writer.drain()
        async with connected(gateway) as raw:
            await answer(raw, whole.encode() + b"\r\nno chunk\r\n") if "chunked" in whole else None
    # What came before is through when this is.
    assert (await http.put("/rcp/v1/context/tenant/alpha/param/limit", json=1.5)).is_success
    assert taken == [1.5]


async def test_trailers_are_no_headers(gateway: Site) -> None:
    trailers = b"Host: evil.example\r\nAuthorization: Bearer nobody\r\nOrigin: http://x\r\n"
    request = post(CHUNKED, b"f\r\n" + PING + b"\r\n0\r\n" + trailers + b"\r\n")
    async with connected(gateway) as raw:
        status, data = await answer(raw, request + get(HOST + b"Connection: close\r\n"))
    assert status == 200
    assert data.count(b"HTTP/1.1 200 OK") == 2
    endless = post(CHUNKED, b"f\r\n" + PING + b"\r\n0\r\nX: " + b"x" * 60_000)
    async with connected(gateway) as raw:
        assert (await answer(raw, endless))[0] == 431


# -- whom it is for --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        (get(b""), 400),
        (get(HOST + HOST), 400),
        (get(HOST + b"Authorization: Bearer a\r\nAuthorization: Bearer b\r\n"), 400),
        (get(b"Host: a b/c\r\n"), 400),
        (get(b"Host: [::1\r\n"), 400),
        (get(b"Host: evil@localhost\r\n"), 400),
        (get(b"Host: localhost:http\r\n"), 400),
        (get(target=b"http://localhost@evil.example" + POSE), 400),
        (get(target=b"http:///" + POSE), 400),
        (get(target=b"ftp://localhost" + POSE), 400),
        (get(target=b"*"), 400),
        (get(target=b"localhost:80"), 400),
        (get(target=POSE + b"#part"), 400),
        (get(version=b"2.0"), 505),
        (b"GET /\r\n\r\n", 505),
        (b"CONNECT evil.example:443 HTTP/1.1\r\n" + HOST + b"\r\n", 501),
        (b"FOO / HTTP/1.1\r\n" + HOST + b"\r\n", 501),
        (b"get / HTTP/1.1\r\n" + HOST + b"\r\n", 501),
        (b"GET /\xff\xfe HTTP/1.1\r\n" + HOST + b"\r\n", 400),
        (handshake(Host=None), 400),
        (handshake().replace(b"HTTP/1.1", b"HTTP/1.0"), 400),
        (handshake(Content_Length="5") + b"hello", 400),
        (handshake(Transfer_Encoding="chunked") + b"5\r\nhello\r\n0\r\n\r\n", 400),
    ],
)
async def test_a_head_that_is_not_one_is_refused(
    gateway: Site, request_: bytes, status: int
) -> None:
    assert (await refused(gateway, request_))[0] == status


@pytest.mark.parametrize(
    ("target", "host", "status"),
    [
        (b"http://localhost", b"localhost", 200),
        (b"HTTP://127.0.0.1:8080", b"evil.example", 200),
        (b"http://evil.example", b"localhost", 403),
        (b"https://evil.example:80", b"localhost", 403),
        (b"http://[zz]", b"localhost", 403),
    ],
)
async def test_an_absolute_target_goes_before_host(
    gateway: Site, target: bytes, host: bytes, status: int
) -> None:
    fields = b"Host: " + host + b"\r\n"
    request = get(fields + b"Connection: close\r\n", target + POSE)
    async with connected(gateway) as raw:
        assert (await answer(raw, request))[0] == status
    upgrade = handshake(Host=host.decode()).replace(b" /rcp", b" " + target + b"/rcp")
    async with connected(gateway) as raw:
        raw.send(upgrade)
        head = await raw.reader.readuntil(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 101") is (status == 200)


async def test_http_1_0_needs_no_host_and_the_whole_gateway_has_options(gateway: Site) -> None:
    async with connected(gateway) as raw:
        assert (await answer(raw, get(b"", version=b"1.0")))[0] == 200
    async with connected(gateway) as raw:
        options = b"OPTIONS * HTTP/1.1\r\nConnection: close\r\n" + HOST + b"\r\n"
        status, data = await answer(raw, options)
    assert status == 204
    assert b"allow: GET, HEAD, PUT, POST, DELETE, OPTIONS" in data


# -- one after the other ---------------------------------------------------------------------------


async def test_what_was_asked_before_the_fault_is_answered_first(gateway: Site) -> None:
    for behind in (b"{nonsense}", b"FOO / HTTP/1.1\r\n\r\n", post(CHUNKED, b"xyz\r\n")):
        async with connected(gateway) as raw:
            status, data = await answer(raw, get() * 3 + behind)
        assert status == 200
        assert data.count(b"HTTP/1.1 200 OK\r\n") == 3
        assert data.count(b"connection: close\r\n") == 1
        assert b'"code":"' in data.rpartition(b"\r\n\r\n")[2]


@pytest.mark.parametrize(
    ("behind", "statuses"),
    [
        (b"", [b"200"] * 3),
        (b"GET /hea", [b"200"] * 3 + [b"400"]),
        (post(b"Content-Length: 15\r\n\r\n", b"{"), [b"200"] * 3 + [b"400"]),
    ],
)
async def test_a_client_that_says_no_more_is_answered(
    gateway: Site, behind: bytes, statuses: list[bytes]
) -> None:
    async with connected(gateway) as raw:
        raw.send(get() * 3 + behind)
        raw.writer.write_eof()
        async with asyncio.timeout(BOUND):
            data = await raw.reader.read()
    found = [part[:3] for part in data.split(b"HTTP/1.1 ")[1:] if part[:3].isdigit()]
    assert found == statuses


async def test_a_websocket_waits_for_no_answer_before_it(gateway: Site) -> None:
    slow = b"POST /rcp/v1/context/action/go?wait=1 HTTP/1.1\r\n" + HOST
    slow += f"Authorization: Bearer {KEY}\r\nContent-Length: 1\r\n\r\n4".encode()
    async with connected(gateway) as raw:
        raw.send(slow + handshake())
        await gateway.robot.started.get()
        gateway.robot.release.set()
        status, data = await answer(raw, b"")
    assert status in (200, 202)
    assert b" 101 " not in data
    assert data.endswith(b"}")
    assert b"HTTP/1.1 400" in data


async def test_a_wish_for_another_protocol_is_passed_over(gateway: Site) -> None:
    upgrade = b"Connection: Upgrade, HTTP2-Settings\r\nUpgrade: h2c\r\nHTTP2-Settings: x\r\n"
    put = b"PUT /rcp/v1/context/tenant/alpha/param/limit HTTP/1.1\r\n" + HOST + upgrade
    put += f"Authorization: Bearer {KEY}\r\n".encode()
    for body in (b"Content-Length: 3\r\n\r\n1.5", CHUNKED + b"3\r\n1.5\r\n0\r\n\r\n"):
        async with connected(gateway) as raw:
            last = get(HOST + b"Connection: close\r\n")
            status, data = await answer(raw, put + body + get(HOST + upgrade) + last)
        assert status == 200
        assert data.count(b"HTTP/1.1 200 OK\r\n") == 3
        assert data.count(b'"type":"write"') == 1


@pytest.mark.serial
async def test_thousands_of_requests_in_one_read_take_turns(
    gateway: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = list[float]()
    inner = HttpProtocol.data_received

    def timed(self: HttpProtocol, data: bytes) -> None:
        began = thread_time()
        inner(self, data)
        taken.append(thread_time() - began)

    monkeypatch.setattr(HttpProtocol, "data_received", timed)
    many = 6_000
    last = get(HOST + b"Connection: close\r\n", b"/last")
    async with connected(gateway) as raw:
        raw.send(get(HOST, b"/q") * many + last)
        found = 0
        async with asyncio.timeout(120):
            while data := await raw.reader.read(1 << 20):
                found += data.count(b"date: ")
    assert found == many + 1
    # One slice is 2 ms; a collection of the garbage of the whole test run may fall into one.
    assert sum(sorted(taken)[:-1]) < 0.1, "other clients waited for all of them"


async def test_a_body_in_small_chunks_is_whole(gateway: Site, http: httpx.AsyncClient) -> None:
    text = "".join(str(number % 10) for number in range(30_000))
    parts = b"".join(b"1\r\n%c\r\n" % character for character in f'"{text}"'.encode())
    put = b"PUT /rcp/v1/context/tenant/alpha/param/text HTTP/1.1\r\n" + HOST
    put += f"Authorization: Bearer {KEY}\r\nConnection: close\r\n".encode()
    taken: list[object] = []

    async def write(name: str, value: object) -> None:
        taken.append(value)

    gateway.robot.write = write  # type: ignore[method-assign, assignment]
    async with connected(gateway) as raw:
        assert (await answer(raw, put + CHUNKED + parts + b"0\r\n\r\n"))[0] == 200
    long = await http.put("/rcp/v1/context/tenant/alpha/param/text", json=text * 100)
    assert long.status_code == 200
    await until(lambda: taken == [text, text * 100])


# -- whatever comes --------------------------------------------------------------------------------

WHOLE = (
    get(),
    post(b"Content-Length: 15\r\n\r\n", PING),
    post(CHUNKED, b"f\r\n" + PING + b"\r\n0\r\n\r\n"),
    handshake(),
)
PIECES = (
    *(b"GET ", b"PUT ", b"CONNECT ", b"PRI * HTTP/2.0\r\n\r\n", POSE, b" HTTP/1.1\r\n", HOST, b"Host:\r\n"),
    *(b"Content-Length: 15\r\n", CHUNKED, b"Upgrade: h2c\r\nConnection: Upgrade\r\n", b"\r\n\r\n"),
    *(b"Expect: 100-continue\r\n", b"f\r\n", b"0\r\n\r\n", PING, b"\0", b"\xff\xfe", b"\x88\x80\0\0\0\0"),
    *(b"%2F", b"*", b"http://localhost/", b"http://evil/", b"x" * 5000, b"Range: bytes=0-1\r\n"),
)  # fmt: skip


def noise(random: Random) -> bytes:
    kind = random.random()
    if kind < 0.15:
        return random.randbytes(random.randrange(1, 400))
    if kind < 0.45:
        return b"".join(random.choices(PIECES, k=random.randrange(1, 14)))
    data = bytearray(b"".join(random.choices(WHOLE, k=random.randrange(1, 6))))
    for _ in range(random.randrange(1, 8)):
        place = random.randrange(len(data) + 1)
        if random.random() < 0.5:
            data[place:place] = random.choice(PIECES)
        else:
            del data[place : place + random.randrange(1, 20)]
    return bytes(data)


async def test_whatever_comes_is_answered_or_closed_in_time() -> None:
    times = "header_timeout = 0.5\nbody_timeout = 0.5\nkeep_alive = 1"
    async with site(asgi=times, http="body_timeout = 0.5") as gateway:
        turns = asyncio.Semaphore(40)

        async def one(seed: int) -> None:
            random = Random(seed)
            data = noise(random)
            async with turns, connected(gateway) as raw, asyncio.timeout(2 * BOUND):
                raw.send(data)
                if random.random() < 0.5:
                    raw.writer.write_eof()
                try:
                    found = await raw.reader.read(16)
                    while not found.startswith(b"HTTP/1.1 101") and await raw.reader.read(65_536):
                        pass
                except ConnectionResetError:
                    return
            assert not found or found.startswith(b"HTTP/1.1 "), data
            assert not found.startswith(b"HTTP/1.1 500"), data

        await asyncio.gather(*(one(seed) for seed in range(400)))
        assert not await _unanswered(gateway)


async def _unanswered(gateway: Site) -> bool:
    async with httpx.AsyncClient(base_url=gateway.url) as http:
        return (await http.get("/healthz")).status_code != 200
