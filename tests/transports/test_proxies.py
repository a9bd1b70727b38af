from __future__ import annotations

from typing import Any

import httpx
import pytest

from rcp_asgi.proxies import Proxies
from rcp_gateway.client_api import Mount
from rcp_gateway.server import prepare
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError
from rcp_web.asgi import peer_of, respond
from transports.robot import Site, site

pytestmark = pytest.mark.anyio


async def who(scope: Any, receive: Any, send: Any) -> None:
    await respond(send, 200, f"{peer_of(scope).address} {scope['client'][0]}".encode())


async def seen(gateway: Site, *forwarded: str) -> str:
    """Return the address of the other end as the gateway sees it."""
    headers = [("x-forwarded-for", value) for value in forwarded]
    async with httpx.AsyncClient(base_url=gateway.url, headers=headers) as http:
        peer, client = (await http.get("/who")).text.split()
    assert peer == client
    return peer


@pytest.mark.parametrize(
    ("forwarded", "expected"),
    [
        ((), "127.0.0.1"),
        (("203.0.113.7",), "203.0.113.7"),
        (("203.0.113.7:4711",), "203.0.113.7"),
        (("[2001:db8::1]:4711",), "2001:db8::1"),
        (("2001:db8::1",), "2001:db8::1"),
        (("6.6.6.6, 203.0.113.7",), "203.0.113.7"),
        (("6.6.6.6", "203.0.113.7"), "203.0.113.7"),
        (("203.0.113.7, 10.1.2.3",), "203.0.113.7"),
        (("203.0.113.7, nonsense",), "127.0.0.1"),
        (("10.1.2.3, 127.0.0.1",), "127.0.0.1"),
        (("",), "127.0.0.1"),
    ],
)
async def test_a_listed_proxy_says_whom_it_speaks_for(
    forwarded: tuple[str, ...], expected: str
) -> None:
    async with site(asgi='proxies = ["127.0.0.1", "10.0.0.0/8"]') as gateway:
        gateway.server.client_api.mount(Mount(name="who", prefix="/who", app=who))
        assert await seen(gateway, *forwarded) == expected


async def test_nobody_else_is_believed(gateway: Site) -> None:
    gateway.server.client_api.mount(Mount(name="who", prefix="/who", app=who))
    assert await seen(gateway, "203.0.113.7") == "127.0.0.1"


def test_a_proxy_is_an_address_or_a_network() -> None:
    assert "::ffff:10.1.2.3" in Proxies(["10.0.0.0/8"])
    assert "2001:db8::1" not in Proxies(["10.0.0.0/8"])
    with pytest.raises(ConfigError, match=r"proxies: 'proxy\.example'"):
        prepare(parse('[transports.asgi]\nproxies = ["proxy.example"]\n', "f"), "f")
