"""Places: names of points and areas, for people, goals and models."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Callable, Iterable
from contextlib import asynccontextmanager
from typing import Any

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.config.role import Rule
from rcp_kernel.features import Feature, FeatureHost, FeatureKind, ServiceKey, SystemResource
from rcp_kernel.model import Operation, Resource
from rcp_kernel.sessions.session import Session
from rcp_places.config import PlacesConfig, check
from rcp_places.messages import Edit, Place
from rcp_places.places import PATH, Places

__all__ = ["FIND", "Edit", "Place", "PlacesConfig", "rcp_features"]

FIND: ServiceKey[Callable[[Session, str, str], dict[str, Any]]] = ServiceKey("places.find")
"""Returns where a place is, for a session, by the tenant of the robot that goes there, and its name."""
_LOOK = Rule(("discover", "read", "subscribe"), (PATH,))
_EDIT = Rule(("execute",), (PATH,))
_RESOURCE = Resource(
    name="service/places",
    description='Named places and areas, for goals such as `{"position": {"place": "dock"}}`; people set and remove them.',
    value=list[Place],
    input=Edit,
    output=Place | None,
    operations=Operation.READ | Operation.SUBSCRIBE | Operation.EXECUTE,
    examples=(
        {"name": "dock", "description": "Charger at the gate.", "robot": "/tenant/alpha"},
        {"name": "gate", "position": {"latitude": -35.3632, "longitude": 149.1653}},
        {"do": "remove", "name": "gate"},
    ),
    history=1,
)


def _make(config: PlacesConfig, host: FeatureHost) -> Feature:
    places = Places(config, host)

    @asynccontextmanager
    async def running() -> AsyncGenerator[None]:
        places.restore()
        yield

    shown = SystemResource(resource=_RESOURCE, view=places.view, execute=places.edit)
    return Feature(
        resources=(shown,),
        services={FIND: places.find},
        reconfigure=places.configure,
        running=running,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Offer places."""
    grants = {
        "viewer": (_LOOK,), "hub": (_LOOK,), "agent": (_LOOK,), "operator": (_LOOK, _EDIT)
    }  # fmt: skip
    return [FeatureKind("places", PlacesConfig, _make, __doc__ or "", grants=grants, check=check)]
