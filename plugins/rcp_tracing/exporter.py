"""OpenTelemetry's SDK with the ids of RCP: that of a command's span is in the command's own id."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor
from opentelemetry.sdk.trace.id_generator import RandomIdGenerator
from opentelemetry.sdk.trace.sampling import TraceIdRatioBased

from rcp_kernel.contract.version import gateway_version
from rcp_protocol.timeouts import timeout
from rcp_protocol.trace import Trace
from rcp_tracing.config import TracingConfig
from rcp_tracing.spans import Tracer

__all__ = ["exporting"]


class _Ids(RandomIdGenerator):
    """Random ids, but for the span that is made next."""

    def __init__(self) -> None:
        self.next: Trace | None = None

    def generate_span_id(self) -> int:
        if self.next is None:
            return super().generate_span_id()
        found, self.next = int(self.next.span, 16), None
        return found

    def generate_trace_id(self) -> int:
        return super().generate_trace_id() if self.next is None else int(self.next.id, 16)


@asynccontextmanager
async def exporting(config: TracingConfig) -> AsyncGenerator[Tracer]:
    """Export spans from a thread while entered; what is left is sent at the end, within the time-out."""
    ids = _Ids()
    provider = TracerProvider(
        sampler=TraceIdRatioBased(config.ratio),
        resource=Resource.create(
            {"service.name": config.service, "service.version": gateway_version()}
        ),
        id_generator=ids,
        shutdown_on_exit=False,
    )
    exporter = OTLPSpanExporter(
        endpoint=config.endpoint, headers=config.headers, timeout=config.timeout
    )
    provider.add_span_processor(BatchSpanProcessor(exporter, schedule_delay_millis=1000))

    def named(trace: Trace | None) -> None:
        ids.next = trace

    try:
        yield Tracer(provider.get_tracer("rcp-gateway"), named)
    finally:
        try:
            async with timeout(config.timeout):
                await asyncio.to_thread(provider.shutdown)
        except TimeoutError:
            pass  # a collector that is away does not keep the gateway from ending
