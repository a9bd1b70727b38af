"""What we use of other libraries beyond their public API: pinned from above, and named here.

A version that fails here changed something that we build upon: look at the module that a test names
before raising the bound in `pyproject.toml`.
"""

from __future__ import annotations

import asyncio
import inspect
import logging
import re
import socket
import tomllib
from pathlib import Path
from typing import Annotated, Any

import msgspec
import pytest
from httptools import HttpRequestParser
from msgspec import Meta
from picows import WSAutoPingStrategy
from picows.picows import WSProtocol
from uvicorn.config import Config
from uvicorn.protocols.http import httptools_impl
from uvicorn.protocols.http.flow_control import HIGH_WATER_LIMIT, FlowControl
from uvicorn.server import ServerState

from rcp_protocol.validation import fault_of

OPEN = Path("/proc/self/fd")
PINNED = (
    "a2a-sdk", "httptools", "mcp", "msgspec", "paho-mqtt", "picows", "ros-rclpy", "uvicorn"
)  # fmt: skip
PROJECT = tomllib.loads((Path(__file__).parent.parent / "pyproject.toml").read_text())["project"]


@pytest.mark.parametrize("name", PINNED)
def test_what_has_no_public_api_for_us_is_pinned_from_above(name: str) -> None:
    extras = PROJECT["optional-dependencies"].values()
    every = [*PROJECT["dependencies"], *(one for extra in extras for one in extra)]
    found = [one for one in every if re.match(rf"{name}(\[.*\])?[<>=~!]", one)]
    assert found
    assert all(re.search(r"<\d", one) for one in found), found


@pytest.mark.anyio
async def test_uvicorns_http_protocol() -> None:
    """For rcp_asgi/http.py, exchange.py, flow.py and upgrade.py."""
    seen: list[tuple[set[str], set[str]]] = []

    async def app(scope: Any, receive: Any, send: Any) -> None:
        cycle: Any = made[0].cycle
        seen.append((set(dir(made[0])), set(dir(cycle))))
        await send({"type": "http.response.start", "status": 204, "headers": []})
        await send({"type": "http.response.body"})

    made: list[Any] = []

    def protocol() -> Any:
        config = Config(app, lifespan="off", log_config=None)
        config.load()
        made.append(httptools_impl.HttpToolsProtocol(config, ServerState(), {}))
        return made[0]

    server = await asyncio.get_running_loop().create_server(protocol, "127.0.0.1", 0)
    async with server:
        host, port = server.sockets[0].getsockname()[:2]
        reader, writer = await asyncio.open_connection(host, port)
        writer.write(b"GET / HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n")
        async with asyncio.timeout(60):
            answer = await reader.read()
        writer.close()
    assert answer.startswith(b"HTTP/1.1 204 ")
    ((of_protocol, of_cycle),) = seen
    used = """
        app client connections cycle flow headers loop parser pipeline scheme scope server_state
        timeout_keep_alive timeout_keep_alive_handler timeout_keep_alive_task transport url
        access_log access_logger expect_100_continue logger _should_upgrade _start_asgi_task
        _unset_keepalive_if_required connection_made connection_lost pause_writing resume_writing
        data_received eof_received on_message_begin on_url on_header on_headers_complete on_body
        on_message_complete on_response_complete
    """
    assert set(used.split()) <= of_protocol
    used = """
        body chunked_encoding default_headers disconnected expected_content_length flow keep_alive
        message_event response_complete response_started scope transport waiting_for_100_continue
    """
    assert set(used.split()) <= of_cycle
    flow = {"read_paused", "write_paused", "pause_reading", "resume_reading", "drain"}
    assert flow <= set(dir(FlowControl(asyncio.Transport())))
    assert httptools_impl.STATUS_LINE[204].startswith(b"HTTP/1.1 204 ")
    assert HIGH_WATER_LIMIT > 0


def test_httptools_tells_a_parser_of_what_comes() -> None:
    """For rcp_asgi/http.py, which is called by the names that uvicorn's protocol has."""
    received: list[str] = []

    class Listener:
        def __getattr__(self, name: str) -> Any:
            return lambda *_: received.append(name)

    parser = HttpRequestParser(Listener())
    parser.feed_data(b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 1\r\n\r\nx")
    wanted = "message_begin url header headers_complete body message_complete"
    assert [f"on_{name}" for name in wanted.split()] == [
        n for n in dict.fromkeys(received) if n != "on_chunk_header"
    ]


@pytest.mark.anyio
async def test_picows_protocol_takes_over_a_connection() -> None:
    """For rcp_asgi/upgrade.py, which builds it by position and feeds it."""
    listen: Any = lambda _: None  # noqa: E731
    silent = logging.getLogger("test")
    protocol: Any = WSProtocol(
        None, None, False, listen, silent, False, None, False, None, None,
        WSAutoPingStrategy.PING_WHEN_IDLE, False, 1024, None, 1024,
    )  # fmt: skip
    assert {"connection_made", "get_buffer", "buffer_updated"} <= set(dir(protocol))


class Inner(msgspec.Struct, forbid_unknown_fields=True):
    needed: int
    rate: Annotated[float, Meta(ge=0, lt=2)] = 0.0
    gears: dict[Annotated[str, Meta(max_length=2)], int] = {}


class Outer(msgspec.Struct):
    inner: list[Inner]


@pytest.mark.parametrize(
    ("value", "wanted"),
    [
        ({"needed": 1, "rate": -1}, (".inner[0].rate", False, (">=", "0"), None, None)),
        ({"needed": 1, "rate": 2.0}, (".inner[0].rate", False, ("<", "2"), None, None)),
        ({}, (".inner[0]", False, None, "needed", None)),
        ({"needed": 1, "speed": 1}, (".inner[0]", False, None, None, "speed")),
        ({"needed": "1"}, (".inner[0].needed", False, None, None, None)),
        ({"needed": 1, "gears": {"a": "1"}}, (".inner[0].gears[...]", False, None, None, None)),
        ({"needed": 1, "gears": {"abc": 1}}, (".inner[0].gears", True, None, None, None)),
    ],
)
def test_msgspec_tells_a_fault_by_its_text_alone(value: Any, wanted: tuple[Any, ...]) -> None:
    """For rcp_protocol/validation.py: decoding and converting say the same."""
    whole = {"inner": [value]}
    with pytest.raises(msgspec.ValidationError) as converting:
        msgspec.convert(whole, Outer)
    with pytest.raises(msgspec.ValidationError) as decoding:
        msgspec.json.decode(msgspec.json.encode(whole), type=Outer)
    assert fault_of(converting.value)[1:] == fault_of(decoding.value)[1:] == wanted
    assert " - at " not in fault_of(converting.value).what


def test_an_mcp_session_has_a_connection_that_can_be_hung_upon() -> None:
    """For rcp_mcp/listeners.py."""
    from mcp.server.connection import Connection
    from mcp.server.session import ServerSession

    outbound: Any = object()
    connection = Connection(outbound, protocol_version="2025-11-25")
    session = ServerSession(outbound, connection)
    assert session._connection is connection  # noqa: SLF001 - what rcp_mcp uses
    assert callable(connection.exit_stack.callback)


def test_an_a2a_request_keeps_its_parameters() -> None:
    """For rcp_a2a/agent.py."""
    from a2a.server.agent_execution import RequestContext

    assert "self._params" in inspect.getsource(RequestContext.__init__)


def test_paho_closes_every_socket_of_a_client() -> None:
    """For rcp_vda5050/robots.py, whose thread may have connected again after it was ended."""
    from paho.mqtt.client import Client
    from paho.mqtt.enums import CallbackAPIVersion

    with socket.create_server(("127.0.0.1", 0)) as server:
        client: Any = Client(CallbackAPIVersion.VERSION2)
        before = len(list(OPEN.iterdir()))
        client.connect("127.0.0.1", server.getsockname()[1])
        peer, _ = server.accept()
        with peer:
            assert len(list(OPEN.iterdir())) > before + 1
            client._reset_sockets()  # noqa: SLF001 - what rcp_vda5050 uses
            assert client.socket() is None
            assert len(list(OPEN.iterdir())) == before + 1  # the peer's
