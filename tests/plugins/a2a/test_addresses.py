"""No notification goes to a place that is not on the internet, unless the configuration lists it."""

from __future__ import annotations

import asyncio
import socket
from ipaddress import ip_address, ip_network
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from rcp_a2a.addresses import Addresses, Unfit, Unknown
from rcp_a2a.config import PushConfig
from rcp_kernel.errors import ConfigError

pytestmark = pytest.mark.anyio
INSIDE = [
    "https://127.0.0.1/hook",
    "https://localhost/hook",
    "https://[::1]/hook",
    "https://10.1.2.3/hook",
    "https://192.168.0.1:8443/hook",
    "https://172.16.9.9/hook",
    "https://169.254.169.254/latest/meta-data",
    "https://100.64.0.1/hook",
    "https://0.0.0.0/hook",
    "https://224.0.0.1/hook",
    "https://240.0.0.1/hook",
    "https://[::ffff:127.0.0.1]/hook",
    "https://[64:ff9b::7f00:1]/hook",
    "https://[2002:7f00:1::]/hook",
    "https://[fe80::1]/hook",
    "https://[fd00::1]/hook",
    "https://2130706433/hook",
    "https://0x7f.1/hook",
]
MALFORMED = [
    "ftp://8.8.8.8/hook",
    "file:///etc/passwd",
    "https://user:secret@8.8.8.8/hook",
    "https:///hook",
    "https://8.8.8.8:99999/hook",
    "https://[::1/hook",
    "",
    "https://8.8.8.8/" + "x" * 3000,
]


@pytest.mark.parametrize("url", INSIDE + MALFORMED)
async def test_an_address_inside_or_malformed_is_refused(url: str) -> None:
    assert not await Addresses(PushConfig(http=True)).fits(url)


async def test_an_address_outside_is_called_as_it_was_judged() -> None:
    judged = await Addresses(PushConfig()).judge("https://8.8.8.8:8443/hook?x=1#part")
    assert (judged.url, judged.host, judged.name) == (
        "https://8.8.8.8:8443/hook?x=1",
        "8.8.8.8:8443",
        "8.8.8.8",
    )


async def test_plain_http_is_called_only_where_the_configuration_says_so() -> None:
    assert not await Addresses(PushConfig()).fits("http://8.8.8.8/hook")
    assert await Addresses(PushConfig(http=True)).fits("http://8.8.8.8/hook")


async def test_a_network_inside_is_called_if_it_is_listed() -> None:
    listed = Addresses(PushConfig(private=("10.0.5.0/24", "fd00:1::/32")))
    assert await listed.fits("https://10.0.5.9/hook")
    assert await listed.fits("https://[::ffff:10.0.5.9]/hook")
    assert await listed.fits("https://[fd00:1::9]/hook")
    assert not await listed.fits("https://10.0.6.9/hook")


def leads_to(monkeypatch: pytest.MonkeyPatch, *answers: list[str]) -> list[str]:
    """Have each look-up of a name answered with the next addresses; returns what was asked."""
    requests: list[str] = []
    waiting = list(answers)

    async def getaddrinfo(name: str, port: int, **_: Any) -> list[Any]:
        requests.append(name)
        found = waiting.pop(0)
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (a, port)) for a in found]

    monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", getaddrinfo)
    return requests


async def test_a_name_is_looked_up_once_and_called_by_what_was_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = leads_to(monkeypatch, ["93.184.216.34"], ["127.0.0.1"])
    judged = await Addresses(PushConfig()).judge("https://rebind.example/hook")
    assert asked == ["rebind.example"]
    assert judged.url == "https://93.184.216.34/hook"
    assert (judged.host, judged.name) == ("rebind.example", "rebind.example")


async def test_a_name_with_one_address_inside_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    leads_to(monkeypatch, ["93.184.216.34", "10.0.0.1"])
    with pytest.raises(Unfit):
        await Addresses(PushConfig()).judge("https://both.example/hook")


@given(st.ip_addresses())
@example(ip_address("2002:102:304::"))  # 6to4: it leads to 1.2.3.4
@example(ip_address("2002:a00:1::"))  # and to 10.0.0.1
def test_whatever_is_called_is_on_the_internet_or_listed(address: Any) -> None:
    listed = ip_network("10.7.0.0/16")
    host = f"[{address}]" if address.version == 6 else str(address)
    judge = Addresses(PushConfig(private=(str(listed),)))
    fits = asyncio.run(judge.fits(f"https://{host}/"))
    within = (getattr(address, name, None) for name in ("ipv4_mapped", "sixtofour"))
    plain = next(filter(None, within), address)
    assert not fits or plain in listed or ip_address(str(plain)).is_global


async def test_a_name_that_cannot_be_looked_up_may_be_named_and_is_not_called(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def getaddrinfo(*_: Any, **__: Any) -> list[Any]:
        raise socket.gaierror

    monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", getaddrinfo)
    assert await Addresses(PushConfig()).fits("https://later.example/hook")
    with pytest.raises(Unknown):
        await Addresses(PushConfig()).judge("https://later.example/hook")


def test_a_network_that_is_none_is_told_with_its_place() -> None:
    with pytest.raises(ConfigError, match=r"\[plugins.a2a.push\] private"):
        Addresses(PushConfig(private=("10.0.5.1/24",)))
