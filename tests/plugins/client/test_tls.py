from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509

import rcp_client
from certs import Authority, Signed
from configuration import tls
from rcp_client.errors import ConnectionLost
from transports.robot import KEY, Site, site

pytestmark = pytest.mark.anyio
RCPCTL = Path(sys.executable).parent / "rcpctl"
BOUND = 60.0  # s
MAPPED = '[[certificates]]\nname = "anna"\nsubject = "anna"\nrole = "operator"\n'


@pytest.fixture
def ca(tmp_path: Path) -> Authority:
    return Authority(tmp_path)


@asynccontextmanager
async def secured(server: Signed, **more: Any) -> AsyncGenerator[Site]:
    async with site(asgi=tls(server, **more), more=MAPPED) as gateway:
        yield gateway


async def rcpctl(*arguments: str, **env: str) -> tuple[int, str, str]:
    made = await asyncio.create_subprocess_exec(
        RCPCTL,
        *arguments,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env={"PYTHONPATH": ":".join(sys.path), "HOME": "/nonexistent", **env},
    )
    out, error = await asyncio.wait_for(made.communicate(), BOUND)
    return made.returncode or 0, out.decode(), error.decode()


async def test_the_client_speaks_tls_and_shows_its_certificate(ca: Authority) -> None:
    anna = ca.sign("anna")
    mutual = {"client_certificates": "required", "client_ca": ca.file}
    shown = {"cert": str(anna.cert), "key": str(anna.key), "cacert": str(ca.file)}
    async with secured(ca.server(), **mutual) as gateway:
        for url in (gateway.url, gateway.url.replace("https", "wss")):
            async with rcp_client.connect(url, **shown) as robot:
                assert robot.greeting["principal"] == "anna"
                assert await robot.write("/tenant/alpha/param/limit", 1.5) == 1.5
        with pytest.raises(ConnectionLost):
            async with rcp_client.connect(gateway.url, cacert=str(ca.file), token=KEY):
                pass


async def test_rcpctl_takes_its_files_from_options_or_the_environment(ca: Authority) -> None:
    anna = ca.sign("anna")
    files = {"RCP_CACERT": str(ca.file), "RCP_CERT": str(anna.cert), "RCP_KEY": str(anna.key)}
    options = ("--cacert", files["RCP_CACERT"], "--cert", files["RCP_CERT"])
    key = ("--cert-key", files["RCP_KEY"])
    write = ("write", "/tenant/alpha/param/limit", "1.25")
    shown = {"client_certificates": "optional", "client_ca": ca.file}
    async with secured(ca.server(), **shown) as gateway:
        url = ("--url", gateway.url)
        code, out, error = await rcpctl(*url, *write, **files)
        assert (code, error) == (0, "")
        assert json.loads(out)["body"] == 1.25
        assert (await rcpctl(*url, *options, *key, *write))[0] == 0
        assert (await rcpctl(*url, *options[:2], *write))[0] == 3
        code, _, error = await rcpctl(*url, "--cert-key", files["RCP_KEY"], *write)
        assert (code, "needs its certificate" in error) == (2, True)
        code, _, error = await rcpctl(*url, "--cacert", "/nonexistent/ca.pem", *write)
        assert (code, "file /nonexistent/ca.pem not found" in error) == (2, True)


async def test_a_gateway_that_cannot_be_trusted_gets_no_token(
    ca: Authority, tmp_path: Path
) -> None:
    (tmp_path / "other").mkdir()
    other = Authority(tmp_path / "other")
    elsewhere = ca.sign("gateway", sans=(x509.DNSName("elsewhere.example"),), file="elsewhere")
    expired = ca.sign("gateway", sans=(x509.DNSName("localhost"),), days=(-2, -1), file="old")
    for server, cacert, told in [
        (ca.server(), other.file, "not trusted"),
        (elsewhere, ca.file, "not trusted: .*mismatch"),
        (expired, ca.file, "not trusted: .*expired"),
    ]:
        async with secured(server) as gateway:
            url = gateway.url.replace("127.0.0.1", "localhost")
            with pytest.raises(ConnectionLost, match=told):
                async with rcp_client.connect(url, cacert=str(cacert), token=KEY):
                    pass
            assert not gateway.server.gateway.sessions.known
    async with secured(ca.server()) as gateway:
        code, _, error = await rcpctl("--url", gateway.url, "--token", KEY, "status")
        assert code == 4
        assert "RCP_CACERT" in error


@pytest.mark.parametrize("url", ["http://192.0.2.1:8080", "robot.example", "ws://localhost.evil"])
def test_a_token_is_not_sent_where_others_can_read_it(url: str) -> None:
    with pytest.raises(ValueError, match="in plain text"):
        rcp_client.connect(url, token=KEY)
    rcp_client.connect(url)
    rcp_client.connect(url, token=KEY, plaintext=True)
    for own in ("http://127.0.0.1:8080", "http://[::1]:8080", "localhost", "https://robot.example"):
        rcp_client.connect(own, token=KEY)


async def test_rcpctl_refuses_to_show_a_token_to_the_network() -> None:
    url = ("--url", "http://192.0.2.1:8080")
    code, _, error = await rcpctl(*url, "status", RCP_TOKEN=KEY)
    assert (code, "--plaintext" in error) == (2, True)


async def test_a_token_does_not_follow_a_redirect() -> None:
    requests: list[bytes] = []

    async def redirect(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        requests.append(await reader.readuntil(b"\r\n\r\n"))
        writer.write(b"HTTP/1.1 302 Found\r\nLocation: ws://127.0.0.1:%d/\r\n" % port)
        writer.write(b"Content-Length: 0\r\nConnection: close\r\n\r\n")
        writer.close()

    server = await asyncio.start_server(redirect, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    async with server:
        with pytest.raises(ConnectionLost, match="HTTP 302"):
            async with rcp_client.connect(f"http://127.0.0.1:{port}", token=KEY):
                pass
    assert len(requests) == 1
