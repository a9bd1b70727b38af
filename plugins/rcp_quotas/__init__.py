"""Quotas: how much of the gateway each tenant and each principal may use."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager

from prometheus_client.core import Metric

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.contract.metrics import counter
from rcp_kernel.features import Feature, FeatureHost, FeatureKind
from rcp_quotas.config import Quota, Quotas, QuotaTables, from_gateway
from rcp_quotas.tracker import QuotaTracker

__all__ = ["Quota", "QuotaTables", "Quotas", "rcp_features"]


def _make(tables: QuotaTables, host: FeatureHost) -> Feature:
    tracker = QuotaTracker(tables, host)

    def reconfigure(tables: QuotaTables) -> None:
        tracker.tables = tables

    def metrics() -> Iterable[Metric]:
        yield counter(
            "rcp_quota_refused",
            "What a quota did not allow.",
            ("quota", "tenant", "what"),
            [(list(key), count) for key, count in tracker.refused().items()],
        )

    @asynccontextmanager
    async def running() -> AsyncGenerator[None]:
        try:
            yield
        finally:
            tracker.close()

    return Feature(
        accounting=tracker,
        reader_status=lambda session: {"quotas": tracker.plain(session)},
        metrics=metrics,
        reconfigure=reconfigure,
        running=running,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Register the feature `quotas`."""
    return [FeatureKind("quotas", QuotaTables, _make, __doc__ or "", table=from_gateway)]
