"""A trace leads from a client, over each wire, through the gateway to the robot, as a collector receives it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncGenerator, Generator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import httpx
import pytest
from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest
from opentelemetry.sdk.trace import TracerProvider

import rcp_client
from configuration import backend, key, listener, table
from plugins.a2a.agent import VERSION, data
from plugins.mcp.rig import Caller
from rcp_gateway.testing import OPERATOR, Served, serve
from rcp_kernel.config.file import parse
from rcp_kernel.errors import RcpError
from rcp_protocol.trace import Trace, carried, current_trace, trace_of, traced

pytestmark = pytest.mark.anyio
TRACE = "4bf92f3577b34da6a3ce929d0e0e4736"
SPAN = "00f067aa0ba902b7"
PARENT = f"00-{TRACE}-{SPAN}-01"
DOUBLE = "/tenant/alpha/service/clear_faults"
BOUND = 60.0  # s


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


class Collector:
    """An OpenTelemetry collector: OTLP over HTTP, with protobuf."""

    def __init__(self) -> None:
        self.spans: dict[str, Any] = {}
        self.services: set[str] = set()
        self.headers: list[str | None] = []
        collector = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                collector.take(self.rfile.read(int(self.headers["content-length"])))
                collector.headers.append(self.headers["authorization"])
                self.send_response(200)
                self.end_headers()

            def log_message(self, *_: object) -> None:
                pass

        self.http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.http.server_port}/v1/traces"

    def take(self, body: bytes) -> None:
        for resource in ExportTraceServiceRequest.FromString(body).resource_spans:
            facts = {one.key: one.value.string_value for one in resource.resource.attributes}
            self.services.add(facts["service.name"])
            for scope in resource.scope_spans:
                self.spans |= {span.span_id.hex(): span for span in scope.spans}

    def of(self, trace: str) -> dict[str, Any]:
        """Return the spans of a trace by name."""
        return {one.name: one for one in self.spans.values() if one.trace_id.hex() == trace}


@pytest.fixture
def collector() -> Generator[Collector]:
    made = Collector()
    thread = threading.Thread(target=made.http.serve_forever, daemon=True)
    thread.start()
    yield made
    made.http.shutdown()
    made.http.server_close()
    thread.join(BOUND)


def tracing(collector: Collector, **fields: Any) -> str:
    given = {"endpoint": collector.url, "service": "yard", "headers": {"authorization": "Bearer x"}}
    return table("features.tracing", **{**given, **fields})


def rover(collector: Collector, **fields: Any) -> str:
    return (
        listener(grace=0.1)
        + backend("rover", use="sim")
        + "[plugins.mcp]\n[plugins.a2a]\n"
        + tracing(collector, **fields)
        + key("operator", OPERATOR)
    )


async def served(text: str) -> AsyncGenerator[tuple[Served, str]]:
    async with serve(parse(text, "test")) as made:
        yield made, next(one["url"] for one in made.server.status.transports if "url" in one)


def child(spans: dict[str, Any], name: str, parent: str) -> Any:
    span = spans[name]
    assert span.parent_span_id.hex() == parent
    assert span.end_time_unix_nano >= span.start_time_unix_nano
    return span


async def test_each_wire_carries_a_trace_to_the_robot(collector: Collector) -> None:
    own = TracerProvider().get_tracer("test")
    with own.start_as_current_span("websocket") as span:
        ids = {"websocket": (span.context.trace_id, span.context.span_id)}
        async for _, url in served(rover(collector)):
            async with rcp_client.connect(url, token=OPERATOR) as client:
                await client.execute(DOUBLE)
                await client.write("/param/speed_limit", 1.0)
            head = {"authorization": f"Bearer {OPERATOR}"}
            async with httpx.AsyncClient(headers=head, timeout=BOUND, trust_env=False) as http:
                for name in ("http", "mcp", "a2a"):
                    ids[name] = (int.from_bytes(name.encode()), 7)
                sent = {
                    name: Trace(f"{trace:032x}", f"{at:016x}") for name, (trace, at) in ids.items()
                }
                answer = await http.post(
                    f"{url}/rcp/v1/context{DOUBLE}", headers={"traceparent": sent["http"].parent}
                )
                assert answer.json()["x-traceparent"] == sent["http"].parent
                plan = {"steps": [{"id": "a", "do": "execute", "path": "/service/clear_faults"}]}
                message = data(plan, metadata={"traceparent": sent["a2a"].parent})
                done = await http.post(f"{url}/a2a/message:send", json=message, headers=VERSION)
                assert done.json()["task"]["status"]["state"] == "TASK_STATE_COMPLETED", done.text
            mcp = Caller(f"{url}/mcp", OPERATOR)
            meta = {"traceparent": sent["mcp"].parent}
            given = {"path": "/service/clear_faults"}
            await mcp.ask("tools/call", name="execute", arguments=given, meta=meta)
            await mcp.http.aclose()
    # The gateway has stopped: everything is exported.
    for name, trace in sent.items():
        spans = collector.of(trace.id)
        outer = trace.span
        if name == "a2a":
            outer = child(spans, "execute system/plans", outer).span_id.hex()
        command = child(spans, "execute service/clear_faults", outer)
        child(spans, "robot service/clear_faults", command.span_id.hex())
    child(
        collector.of(sent["websocket"].id),
        "write param/speed_limit",
        sent["websocket"].span,
    )
    assert collector.services == {"yard"}
    assert set(collector.headers) == {"Bearer x"}


async def test_a_command_without_a_trace_begins_one_that_its_id_names(collector: Collector) -> None:
    async for _, url in served(rover(collector)):
        async with rcp_client.connect(url, token=OPERATOR) as client:
            handle = await client.start("/action/move_to", {"position": {"x": 0, "y": 9}})
            await handle.cancel()
            with pytest.raises(RcpError):
                await handle.result()
            await client.estop(reason="a try")
    number = handle.id.removeprefix("cmd-")
    spans = collector.of(number * 2)
    span = child(spans, "execute action/move_to", "")
    assert span.span_id.hex() == number
    assert span.status.code == 2
    facts = {one.key: one.value.string_value for one in span.attributes}
    assert facts["error.type"] == "cancelled"
    assert span.events[0].name == "accepted"
    assert any(one.name.startswith("estop") for one in collector.spans.values())


async def test_a_path_that_a_client_made_up_names_no_span(collector: Collector) -> None:
    async for _, url in served(rover(collector)):
        async with rcp_client.connect(url, token=OPERATOR) as client:
            token = current_trace.set(Trace(TRACE, SPAN))
            try:
                for path in ("/param/made_up", "/sensor/pose"):
                    with pytest.raises(RcpError):
                        await client.write(path, 1)
                await client.write("/param/speed_limit", 1.0)
            finally:
                current_trace.reset(token)
    names = [one.name for one in collector.spans.values()]
    assert sorted(names) == ["write", "write", "write param/speed_limit"]


async def test_what_is_not_sampled_is_not_exported(collector: Collector) -> None:
    async for _, url in served(rover(collector)):
        async with rcp_client.connect(url, token=OPERATOR) as client:
            token = current_trace.set(Trace(TRACE, SPAN, sampled=False))
            try:
                await client.execute(DOUBLE)
            finally:
                current_trace.reset(token)
    assert collector.spans == {}


async def test_a_collector_that_is_away_delays_nothing_and_ends_with_the_gateway(
    collector: Collector,
) -> None:
    away = "http://127.0.0.1:9/v1/traces"  # discard
    loop = asyncio.get_running_loop()
    async for _, url in served(rover(collector, endpoint=away, timeout=0.5)):
        async with rcp_client.connect(url, token=OPERATOR) as client:
            await client.execute(DOUBLE)
        began = loop.time()
    assert loop.time() - began < BOUND


@pytest.mark.parametrize(
    "text", ["", "00-0-0-01", f"ff-{TRACE}-{SPAN}-01", f"00-{'0' * 32}-{SPAN}-01", 3, None]
)
def test_a_trace_that_is_none_is_ignored(text: object) -> None:
    assert trace_of({"x-traceparent": text}) is None
    assert carried({"traceparent": text}) is None
    assert traced({"x-traceparent": text}, None) is None


def test_a_command_is_the_parent_of_what_is_done_for_it() -> None:
    found = traced({"x-traceparent": PARENT}, "cmd-0123456789abcdef")
    assert found is not None
    assert found.parent == f"00-{TRACE}-0123456789abcdef-01"
