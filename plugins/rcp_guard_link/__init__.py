"""The guard process: what stops robots while the gateway itself cannot.

This feature starts `rcp_guard`, arms it before anything moves, and sends its heartbeat.
"""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager

from rcp_gateway.hookspecs import hookimpl
from rcp_guard_link.arming import GuardArming
from rcp_guard_link.link import GuardLink
from rcp_kernel.config.safety import Safety
from rcp_kernel.features import Feature, FeatureHost, FeatureKind

__all__ = ["rcp_features"]


def _make(safety: Safety, host: FeatureHost) -> Feature:
    arming = GuardArming(host.loop, safety, host.robots.backends)
    link = GuardLink(arming, host)

    @asynccontextmanager
    async def running() -> AsyncGenerator[None]:
        link.start()
        try:
            yield
        finally:
            await link.close()

    return Feature(
        guard=arming,
        status=link.status,
        metrics=link.metrics,
        running=running,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Register the feature `guard`."""
    kind = FeatureKind("guard", Safety, _make, __doc__ or "", table=lambda config: config.safety)
    return [kind]
