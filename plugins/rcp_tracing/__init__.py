"""Tracing: spans of commands, of traced writes and of e-stops, exported by OTLP to an OpenTelemetry collector."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.features import Feature, FeatureHost, FeatureKind
from rcp_tracing.config import TracingConfig, check

__all__ = ["TracingConfig", "rcp_features"]


def _make(config: TracingConfig, _host: FeatureHost) -> Feature:
    from rcp_tracing.exporter import exporting
    from rcp_tracing.spans import Spans

    spans = Spans()

    @asynccontextmanager
    async def running() -> AsyncGenerator[None]:
        async with exporting(config) as tracer:
            spans.tracer = tracer
            try:
                yield
            finally:
                spans.tracer = None

    return Feature(
        on_command=spans.on_command,
        feedback=False,
        on_event=spans.on_event,
        running=running,
    )


@hookimpl
def rcp_features() -> list[FeatureKind]:
    """Return the feature."""
    return [
        FeatureKind(
            name="tracing",
            config=TracingConfig,
            make=_make,
            description="Exports spans of commands by OTLP.",
            needs=("opentelemetry.sdk", "opentelemetry.exporter.otlp.proto.http"),
            check=lambda table, _config: check(table),
        )
    ]
