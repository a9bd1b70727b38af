from __future__ import annotations

import asyncio
import json
import ssl
from collections.abc import AsyncGenerator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from cryptography import x509
from structlog.testing import capture_logs
from websockets.asyncio.client import connect

from certs import Authority, Signed
from configuration import tls
from rcp_asgi.config import TlsConfig
from rcp_asgi.tls import Tls
from rcp_gateway.log import configure
from rcp_kernel.errors import ConfigError
from transports.raw import TEXT, Raw, connected, frame, handshake
from transports.robot import BOUND, KEY, Site, site, until

pytestmark = pytest.mark.anyio
POSE = "/rcp/v1/context/tenant/alpha/sensor/pose"
MAPPED = """
[[certificates]]
name = "anna"
subject = "anna"
role = "operator"
tenants = ["alpha"]
[[certificates]]
name = "arms"
san = "DNS:*.arms.example"
issuer = "CN=Test CA,O=Example"
role = "viewer"
[[certificates]]
name = "op"
subject = "CN=op,O=Example"
role = "viewer"
"""


@pytest.fixture(params=[False, True], ids=["asyncio", "uvloop"])
def anyio_backend(request: pytest.FixtureRequest) -> tuple[str, dict[str, bool]]:
    """Run on both loops: each has a TLS of its own, and `rcpd` takes uvloop where there is one."""
    return "asyncio", {"use_uvloop": request.param}


@pytest.fixture
def ca(tmp_path: Path) -> Authority:
    return Authority(tmp_path)


def trusting(ca: Authority, client: Signed | None = None) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=ca.file)
    if client is not None:
        context.load_cert_chain(*client.pair)
    return context


@asynccontextmanager
async def secured(ca: Authority, *, top: str = "", **fields: Any) -> AsyncGenerator[Site]:
    async with site(top=top, asgi=tls(ca.server(), **fields), more=MAPPED) as gateway:
        yield gateway


@asynccontextmanager
async def mutual(ca: Authority, kind: str = "required", **fields: Any) -> AsyncGenerator[Site]:
    fields = {"client_certificates": kind, "client_ca": ca.file, **fields}
    async with secured(ca, top="anonymous = false", **fields) as gateway:
        yield gateway


@asynccontextmanager
async def calling(
    gateway: Site, ca: Authority, client: Signed | None = None, key: str | None = None
) -> AsyncGenerator[httpx.AsyncClient]:
    headers = {} if key is None else {"authorization": f"Bearer {key}"}
    async with httpx.AsyncClient(
        base_url=gateway.url, verify=trusting(ca, client), headers=headers, timeout=BOUND
    ) as http:
        yield http


def socket_to(gateway: Site, context: ssl.SSLContext, **more: Any) -> Any:
    return connect(f"wss://127.0.0.1:{gateway.port}/rcp/v1/ws", ssl=context, **more)


async def ask(wire: Any, **envelope: Any) -> dict[str, Any]:
    await wire.send(json.dumps(envelope))
    async with asyncio.timeout(BOUND):
        return json.loads(await wire.recv())


async def expelled(wire: Any) -> None:
    """Wait until the gateway has closed the connection."""
    async with asyncio.timeout(BOUND):
        await wire.wait_closed()
    assert wire.close_code == 1008


# -- TLS -------------------------------------------------------------------------------------------


async def test_every_transport_speaks_tls(
    ca: Authority, anyio_backend: tuple[str, dict[str, bool]]
) -> None:
    loop = type(asyncio.get_running_loop()).__module__
    assert loop.startswith("uvloop") is anyio_backend[1]["use_uvloop"]
    async with secured(ca) as gateway, calling(gateway, ca, key=KEY) as http:
        assert gateway.url.startswith("https://127.0.0.1:")
        assert (await http.get(POSE)).json()["body"]["position"]["x"] == 1.0
        async with http.stream("GET", "/rcp/v1/events?path=/sensor/pose") as events:
            lines = events.aiter_lines()
            while not (await anext(lines)).startswith("data:"):
                pass
        headers = {"authorization": f"Bearer {KEY}"}
        async with socket_to(
            gateway, trusting(ca), additional_headers=headers, max_size=None
        ) as wire:
            written = await ask(wire, type="write", path="/param/text", body="x" * 3_000_000)
            assert written["status"] == "completed"
            read = await ask(wire, type="read", path="/sensor/pose", id="1")
            assert (read["id"], read["status"]) == ("1", "completed")


async def test_long_and_short_updates_arrive_whole_and_in_order_over_tls(ca: Authority) -> None:
    sizes = [10, 20_000, 10, 700_000, 30, 40]
    async with (
        secured(ca) as gateway,
        socket_to(gateway, trusting(ca), max_size=None) as wire,
    ):
        body = {"initial": False, "qos": {"depth": len(sizes)}}
        asked = await ask(wire, type="subscribe", path="/sensor/text", id="s", body=body)
        assert asked["status"] == "completed"
        for number, size in enumerate(sizes):
            gateway.robot.host.publish("sensor/text", str(number) * size)
        async with asyncio.timeout(BOUND):
            bodies = [json.loads(await wire.recv())["body"] for _ in sizes]
        assert bodies == [str(number) * size for number, size in enumerate(sizes)]


async def test_old_versions_of_tls_are_not_spoken(ca: Authority) -> None:
    async with secured(ca) as gateway:
        context = trusting(ca)
        context.set_ciphers("DEFAULT:@SECLEVEL=0")  # or the client itself would not try
        with pytest.warns(DeprecationWarning, match="TLSv1_1"):
            context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_1
        with pytest.raises(OSError):  # noqa: PT011 - an alert, or a reset that overtook it
            await asyncio.open_connection("127.0.0.1", gateway.port, ssl=context)
        counts = gateway.server.gateway.counts.outcomes
        await until(lambda: counts.get(("asgi", "connection", "tls")) == 1)


async def test_plain_http_on_the_tls_port_is_closed(ca: Authority) -> None:
    async with secured(ca) as gateway, connected(gateway) as raw:
        raw.send(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
        async with asyncio.timeout(BOUND):
            assert b"HTTP" not in await raw.reader.read(-1)


@pytest.mark.parametrize("anyio_backend", ["asyncio"])  # uvloop has a clock of its own
async def test_the_first_failed_handshake_is_logged_on_a_machine_that_has_just_booted(
    ca: Authority, boot: Callable[[], None]
) -> None:
    async with secured(ca) as gateway, connected(gateway) as raw:
        configure("info", "json")
        boot()
        with capture_logs() as logs:
            raw.send(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n")
            await until(lambda: any(one["event"] == "handshake_failed" for one in logs))


async def test_a_handshake_that_stalls_is_cut(ca: Authority) -> None:
    asgi = "header_timeout = 0.05\n" + tls(ca.server())
    async with site(asgi=asgi) as gateway, connected(gateway) as silent:
        async with connected(gateway) as raw:
            raw.send(b"\x16\x03\x01\x02\x00\x01")
            await raw.ended()
        await silent.ended()


async def test_who_is_still_in_the_handshake_goes_with_the_gateway(ca: Authority) -> None:
    before = asyncio.all_tasks()
    async with AsyncExitStack() as stack:
        async with secured(ca) as gateway:
            silent = [await stack.enter_async_context(connected(gateway)) for _ in range(3)]
            silent[1].send(b"\x16\x03\x01\x02\x00\x01")
            await stack.enter_async_context(socket_to(gateway, trusting(ca)))
        for raw in silent:
            await raw.ended()
    await until(lambda: not asyncio.all_tasks() - before)


async def test_who_does_not_take_leave_goes_with_the_gateway(ca: Authority) -> None:
    """The gateway has closed the connection, and then once more since it ends itself."""
    into, out = ssl.MemoryBIO(), ssl.MemoryBIO()
    peer = trusting(ca).wrap_bio(into, out, server_hostname="localhost")
    asgi = "grace = 0.05\n" + tls(ca.server())

    async def told(raw: Raw, step: Callable[[], Any]) -> Any:
        while True:
            try:
                return step()
            except ssl.SSLWantReadError:
                raw.send(out.read())
                into.write(await raw.reader.read(65_536))
            finally:
                raw.send(out.read())

    async with AsyncExitStack() as stack, asyncio.timeout(BOUND):
        async with site(asgi=asgi) as gateway:
            raw = await stack.enter_async_context(connected(gateway))
            await told(raw, peer.do_handshake)
            request = b"GET /rcp HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
            await told(raw, lambda: peer.write(request))
            while await told(raw, lambda: peer.read(65_536)):
                pass  # to the end that the gateway tells; it is not answered
        await raw.ended()


async def test_a_websocket_that_breaks_the_rules_is_failed_over_tls_too(ca: Authority) -> None:
    async with secured(ca) as gateway:
        reader, writer = await asyncio.open_connection(
            "127.0.0.1", gateway.port, ssl=trusting(ca), server_hostname="localhost"
        )
        writer.write(handshake())
        async with asyncio.timeout(BOUND):
            assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 101")
            writer.write(frame(TEXT, b"\xff"))
            assert b"\x03\xef" in await reader.read(-1)
        writer.close()


async def test_a_key_may_be_encrypted(ca: Authority) -> None:
    sealed = ca.server(password=b"open sesame")
    good = tls(sealed, key_password="open sesame")
    async with site(asgi=good) as gateway, calling(gateway, ca) as http:
        assert (await http.get("/healthz")).status_code == 200
    for bad in (tls(sealed), tls(sealed, key_password="wrong")):
        with pytest.raises(ConfigError, match="key_password"):
            async with site(asgi=bad):
                pass


async def test_faults_of_the_files_are_faults_of_the_configuration(
    ca: Authority, tmp_path: Path
) -> None:
    server, other = ca.server(), ca.server("other")
    empty = tmp_path / "empty.pem"
    empty.write_text("")
    mine = {"client_certificates": "required", "client_ca": ca.file}
    for bad, told in [
        (tls(server, key=tmp_path / "none"), r"`key` = .* cannot be read"),
        (tls(server, key=other.key), "cannot be loaded"),
        (tls(server, certificate=empty), "cannot be loaded"),
        (tls(server, client_ca=ca.file), "contradicts"),
        (tls(server, client_certificates="optional"), "needs `client_ca`"),
        (tls(server, client_certificates="optional", client_ca=empty), "`client_ca` ="),
        (tls(server, **mine, crl=empty), "`crl` ="),
    ]:
        with pytest.raises(ConfigError, match=told):
            async with site(asgi=bad):
                pass


async def test_new_certificates_come_into_force_without_cutting_anybody(ca: Authority) -> None:
    async with (
        secured(ca) as gateway,
        socket_to(gateway, trusting(ca)) as wire,
    ):
        before = await presented(gateway, ca)
        renewed = ca.server()
        async with asyncio.timeout(BOUND):
            while (now := await presented(gateway, ca)) == before:
                pass
        assert now == renewed.certificate.serial_number
        assert (await ask(wire, type="ping"))["status"] == "completed"
        with capture_logs() as said:
            renewed.cert.write_text("half written")
            await until(lambda: "certificates_refused" in [one["event"] for one in said])
        assert await presented(gateway, ca) == now


async def presented(gateway: Site, ca: Authority) -> int:
    """Return the number of the certificate that a new connection gets."""
    _, writer = await asyncio.open_connection(
        "127.0.0.1", gateway.port, ssl=trusting(ca), server_hostname="localhost"
    )
    der = writer.get_extra_info("ssl_object").getpeercert(binary_form=True)
    writer.close()
    return x509.load_der_x509_certificate(der).serial_number


@pytest.mark.parametrize(("days", "warned"), [(-0.5, True), (13, True), (15, False)])
async def test_a_certificate_near_its_end_is_warned_of(
    ca: Authority,
    days: float,
    warned: bool,  # noqa: FBT001 - a case
) -> None:
    server = ca.sign("gateway", days=(-1, days))
    configure("warning", "json")
    with capture_logs() as said:
        Tls(TlsConfig(certificate=str(server.cert), key=str(server.key))).warn()
    assert ("certificate_expires" in [one["event"] for one in said]) is warned


@pytest.mark.parametrize(("mode", "warned"), [(0o604, True), (0o640, False), (0o600, False)])
def test_a_key_that_all_may_read_is_warned_of(
    ca: Authority,
    mode: int,
    warned: bool,  # noqa: FBT001 - a case
) -> None:
    server = ca.server()
    server.key.chmod(mode)
    configure("warning", "json")
    with capture_logs() as said:
        Tls(TlsConfig(certificate=str(server.cert), key=str(server.key))).warn()
    assert ("key_readable" in [one["event"] for one in said]) is warned


# -- client certificates ---------------------------------------------------------------------------


async def test_a_certificate_proves_who_it_is_on_every_transport(ca: Authority) -> None:
    anna = ca.sign("anna")
    async with mutual(ca) as gateway, calling(gateway, ca, anna) as http:
        put = await http.put("/rcp/v1/context/tenant/alpha/param/limit", json=1.5)
        assert put.status_code == 200
        assert (await http.get("/rcp/v1/context/tenant/beta/sensor/pose")).status_code == 404
        async with http.stream("GET", "/rcp/v1/events?path=/sensor/pose") as events:
            assert events.status_code == 200
        async with socket_to(gateway, trusting(ca, anna)) as wire:
            hello = (await ask(wire, type="hello"))["body"]
            assert (hello["principal"], hello["tenants"]) == ("anna", ["alpha"])
            principal = next(iter(gateway.server.gateway.sessions.known.values())).principal
            assert principal.proof == "certificate"
            assert principal.expires is not None
            assert len(principal.credential or "") == 64


async def test_a_name_may_be_a_pattern_over_one_label(ca: Authority) -> None:
    def named(name: str) -> Signed:
        return ca.sign("x", sans=(x509.DNSName(name),), file=name)

    async with mutual(ca) as gateway:
        for name, status in [
            ("left.arms.example", 200),
            ("a.left.arms.example", 401),
            (".arms.example", 401),
            ("left.arms.example.org", 401),
        ]:
            async with calling(gateway, ca, named(name)) as http:
                assert (await http.get(POSE)).status_code == status, name
        lying = ca.sign("x", sans=(x509.UniformResourceIdentifier("left.arms.example"),))
        async with calling(gateway, ca, lying) as http:
            assert (await http.get(POSE)).status_code == 401


async def test_without_a_good_certificate_nobody_gets_as_far_as_http(
    ca: Authority, tmp_path: Path
) -> None:
    (tmp_path / "other").mkdir()
    expired = ca.sign("anna", days=(-2, -1), file="expired")
    early = ca.sign("anna", days=(1, 2), file="early")
    foreign = Authority(tmp_path / "other").sign("anna")
    revoked = ca.sign("anna", file="revoked")
    good = ca.sign("anna")
    async with mutual(ca, crl=ca.revoke(revoked)) as gateway:
        for client in (None, expired, early, foreign, revoked):
            async with calling(gateway, ca, client, KEY) as http:
                with pytest.raises(httpx.TransportError):
                    await http.get("/healthz")
        async with calling(gateway, ca, good) as http:
            assert (await http.get(POSE)).status_code == 200


async def test_an_optional_certificate_may_be_left_out_but_not_be_bad(ca: Authority) -> None:
    expired = ca.sign("anna", days=(-2, -1))
    unknown = ca.sign("nobody")
    async with mutual(ca, "optional") as gateway:
        async with calling(gateway, ca) as http:
            assert (await http.get(POSE)).status_code == 401
        async with calling(gateway, ca, key=KEY) as http:
            assert (await http.get(POSE)).status_code == 200
        async with calling(gateway, ca, unknown) as http:
            assert (await http.get(POSE)).status_code == 401
        async with calling(gateway, ca, unknown, KEY) as http:
            assert (await http.get(POSE)).status_code == 200
        async with calling(gateway, ca, expired, KEY) as http:
            with pytest.raises(httpx.TransportError):
                await http.get(POSE)


async def test_a_token_decides_and_must_not_contradict_the_certificate(ca: Authority) -> None:
    anna, op = ca.sign("anna"), ca.sign("op")
    limit = "/rcp/v1/context/tenant/alpha/param/limit"
    async with mutual(ca) as gateway:
        async with calling(gateway, ca, op) as http:
            assert (await http.put(limit, json=1)).status_code == 403
        async with calling(gateway, ca, op, KEY) as http:
            assert (await http.put(limit, json=1)).status_code == 200
        async with calling(gateway, ca, anna, "not-a-token-of-anybody") as http:
            assert (await http.put(limit, json=1)).status_code == 401
        async with calling(gateway, ca, anna, KEY) as http:
            refused = await http.put(limit, json=1)
            assert refused.status_code == 401
            assert "certificate to 'anna'" in refused.json()["error"]["message"]
        async with socket_to(gateway, trusting(ca, anna)) as wire:
            hello = await ask(wire, type="hello", body={"token": KEY})
            assert hello["error"]["code"] == "unauthenticated"


async def test_a_revoked_certificate_loses_what_it_has_open(ca: Authority) -> None:
    anna = ca.sign("anna")
    crl = ca.revoke()
    async with (
        mutual(ca, crl=crl) as gateway,
        calling(gateway, ca, anna) as http,
        socket_to(gateway, trusting(ca, anna)) as wire,
    ):
        assert (await ask(wire, type="hello"))["status"] == "completed"
        assert (await http.get(POSE)).status_code == 200
        ca.revoke(anna)
        await expelled(wire)
        assert (await http.get(POSE)).status_code == 401


async def test_a_mapping_taken_out_ends_its_sessions(ca: Authority) -> None:
    anna = ca.sign("anna")
    async with mutual(ca) as gateway, socket_to(gateway, trusting(ca, anna)) as wire:
        assert (await ask(wire, type="hello"))["status"] == "completed"
        kernel = gateway.server.gateway
        from msgspec.structs import replace

        kernel.reconfigure(
            replace(kernel.settings.config, certificates=kernel.settings.config.certificates[1:])
        )
        await expelled(wire)
