"""Links of strangers with a robot's gateway: they leave room for those of its hubs."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest
from structlog.testing import capture_logs

from configuration import backend, configuration, key, table
from ports import free_port

pytest.importorskip("zenoh")

import zenoh

from rcp_gateway.testing import OPERATOR, MemoryClient, Served, eventually, serve
from rcp_kernel.config.file import parse
from rcp_zenoh import declared_keys, transport
from rcp_zenoh.session import configuration as zenoh_configuration
from rcp_zenoh.session import on_loop, opened
from rcp_zenoh.statistics import Statistics

_OPERATOR = key("operator", OPERATOR)
_CLOSED = "anonymous = false\n"


@asynccontextmanager
async def _robot(port: int, head: str = "") -> AsyncGenerator[list[dict[str, Any]]]:
    """Serve a robot; yield what its status says of each hub."""
    hub = [f"tcp/127.0.0.1:{port}"]
    zenoh_table = table("transports.zenoh", gateway="r7", tenant="alpha", connect=hub)
    text = head + configuration(zenoh_table, backend("rover", use="sim"), _OPERATOR)
    async with serve(parse(text, "test")) as served:
        (facts,) = [one for one in served.server.status.transports if "links" in one]
        yield facts["links"]


@asynccontextmanager
async def _hub(port: int) -> AsyncGenerator[Served]:
    listen = [f"tcp/127.0.0.1:{port}"]
    fleet = backend("fleet", use="fleet", hub="h1", listen=listen, token=OPERATOR)
    async with serve(parse(configuration(fleet, _OPERATOR), "test")) as served:
        yield served


@asynccontextmanager
async def _stranger(port: int) -> AsyncGenerator[zenoh.Session]:
    config = zenoh_configuration("client", connect=[f"tcp/127.0.0.1:{port}"])
    async with opened(config, patient=True) as session:
        yield session


async def _has_robot(hub: Served) -> None:
    client: MemoryClient = hub.client(OPERATOR)

    async def reads() -> bool:
        read = await client.request("read", path="/tenant/alpha/sensor/r7/pose")
        return read["status"] == "completed"

    await eventually(reads, "the hub has the robot")
    await client.close()


async def _declared(session: zenoh.Session, names: list[str]) -> list[zenoh.LivelinessToken]:
    say = session.liveliness().declare_token
    return await asyncio.to_thread(lambda: [say(f"rcp/alpha/r7/link/{name}") for name in names])


async def _comes(holds: Callable[[], bool], what: str) -> None:
    async def look() -> bool:
        return holds()

    await eventually(look, what)


def _knows(rows: list[dict[str, Any]], hub: str) -> bool:
    return any(one["hub"] == hub for one in rows)


@asynccontextmanager
async def _told(session: zenoh.Session) -> AsyncGenerator[list[str]]:
    """Yield what the gateway says to all links."""
    said: list[str] = []
    subscriber = session.declare_subscriber(
        "rcp/alpha/r7/out/**",
        on_loop(
            asyncio.get_running_loop(), lambda s: said.append(str(s.payload.to_bytes(), "latin-1"))
        ),
    )
    yield said
    subscriber.undeclare()


async def test_strangers_take_no_place_of_a_hub_and_are_told_why_their_links_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(declared_keys, "_MOST", 8)
    monkeypatch.setattr(transport, "_UNPROVED", 8)
    monkeypatch.setattr(transport, "_MOST", 8)
    port = free_port()
    async with _robot(port, _CLOSED) as rows:
        async with _hub(port) as hub, _stranger(port) as stranger, _told(stranger) as said:
            await _has_robot(hub)
            tokens = await _declared(stranger, [f"evil{n}/{n}" for n in range(40)])
            await _comes(lambda: _knows(rows, "evil39"), "the last one")
            await _comes(
                lambda: sum("did not say who it is before" in one for one in said) == 32, "32 ends"
            )
            await _has_robot(hub)
            del tokens
        async with _hub(port) as hub:
            await _has_robot(hub)


async def test_a_session_whose_keys_are_used_up_is_opened_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(declared_keys, "_MOST", 64)
    port = free_port()
    with capture_logs() as logs:
        async with _robot(port) as rows:
            async with _hub(port) as hub, _stranger(port) as stranger:
                for time in ("early", "late"):
                    tokens = await _declared(stranger, [f"{time}{n}/{n}" for n in range(40)])
                    await _comes(lambda t=time: _knows(rows, f"{t}39"), f"the last of {time}")
                    for token in tokens:
                        token.undeclare()
                await _comes(
                    lambda: "zenoh_session_reopened" in [one["event"] for one in logs], "the log"
                )
                await _has_robot(hub)
            async with _hub(port) as hub:
                await _has_robot(hub)
    (reopened,) = [one for one in logs if one["event"] == "zenoh_session_reopened"]
    assert reopened["log_level"] == "error"


async def test_a_refusal_is_told_to_the_hub_and_logged_now_and_then(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(transport, "_OF_ONE", 4)
    port = free_port()
    with capture_logs() as logs:
        async with (
            _robot(port),
            _hub(port) as hub,
            _stranger(port) as stranger,
            _told(stranger) as said,
        ):
            await _has_robot(hub)
            tokens = await _declared(stranger, [f"evil/{n}" for n in range(100)])
            await _comes(lambda: said.count("this hub has 4 links already") == 96, "96 refusals")
            del tokens
    assert 1 <= len([one for one in logs if one["event"] == "zenoh_link_refused"]) < 10


def test_names_of_hubs_without_links_are_not_remembered_for_ever() -> None:
    statistics = Statistics()
    for number in range(3000):
        statistics.of(f"h{number}")
    assert len(statistics.rows) == 1024
    assert statistics.rows[-1]["hub"] == "h2999"
