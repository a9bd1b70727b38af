"""Layouts: pages that people put together from panels, each of one user or shared in a tenant."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.config.role import Rule
from rcp_kernel.features import Feature, FeatureHost, FeatureKind, SystemResource
from rcp_kernel.model import Operation, Resource
from rcp_layouts.config import LayoutsConfig
from rcp_layouts.layouts import PATH, SHARED, Layouts
from rcp_layouts.messages import Entry, Layout, OwnRequest, SharedRequest

__all__ = ["LayoutsConfig", "rcp_features"]

_LOOK = Rule(("discover", "read", "subscribe"), (PATH, SHARED))
_OWN = Rule(("execute",), (PATH,))
_SHARE = Rule(("execute",), (SHARED,))
_OPERATIONS = Operation.READ | Operation.SUBSCRIBE | Operation.EXECUTE
_CONTENT = {"columns": [{"panels": [{"kind": "note", "text": "Check the battery."}]}]}
_PERSONAL = Resource(
    name="service/layouts",
    description="The caller's own layouts; `execute` opens, saves and removes them.",
    value=list[Entry],
    input=OwnRequest,
    output=Layout | None,
    operations=_OPERATIONS,
    examples=(
        {"do": "open", "name": "main"},
        {"do": "open", "name": "main", "tenant": "alpha"},
        {"do": "save", "name": "main", "version": 0, "content": _CONTENT},
        {"do": "remove", "name": "main", "version": 1},
    ),
    history=1,
)
_SHARED = Resource(
    name="service/shared_layouts",
    description="Layouts that the people of a tenant share; `execute` saves and removes them.",
    value=list[Entry],
    input=SharedRequest,
    output=Layout | None,
    operations=_OPERATIONS,
    examples=(
        {"do": "save", "name": "main", "tenant": "alpha", "version": 0, "content": _CONTENT},
        {"do": "remove", "name": "main", "tenant": "alpha", "version": 1},
    ),
    history=1,
)


def _make(config: LayoutsConfig, host: FeatureHost) -> Feature:
    layouts = Layouts(config, host)

    @asynccontextmanager
    async def running() -> AsyncGenerator[None]:
        layouts.restore()
        yield

    return Feature(
        resources=(
            SystemResource(resource=_PERSONAL, view=layouts.own, execute=layouts.change_own),
            SystemResource(resource=_SHARED, view=layouts.shared, execute=layouts.change_shared),
        ),
        reconfigure=layouts.configure,
        running=running,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Offer layouts."""
    grants = {"viewer": (_LOOK, _OWN), "operator": (_LOOK, _OWN, _SHARE)}
    return [FeatureKind("layouts", LayoutsConfig, _make, __doc__ or "", grants=grants)]
