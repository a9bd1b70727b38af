"""Leases: exclusive control of a sub-tree for a limited time, by priority."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.config.role import Rule
from rcp_kernel.features import Feature, FeatureHost, FeatureKind, SystemResource
from rcp_kernel.features.control import CONTROL, HOLDERS
from rcp_kernel.model import Operation, Resource
from rcp_leases.config import LeasesConfig, check, from_gateway
from rcp_leases.control import LeaseControl
from rcp_leases.leases import Leases
from rcp_leases.requests import PATH, LeaseRequest, LeaseRequests, LeaseState, releases

__all__ = ["LeaseRequest", "LeaseState", "LeasesConfig", "rcp_features"]

_RESOURCE = Resource(
    name="service/leases",
    description="Exclusive control of a part of the tree: list, acquire, renew, release.",
    value=list[LeaseState],
    input=LeaseRequest,
    output=LeaseState,
    operations=Operation.READ | Operation.SUBSCRIBE | Operation.EXECUTE,
    examples=(
        {"do": "acquire", "scope": "/tenant/alpha", "ttl": 10},
        {"do": "acquire", "scope": "/actuator", "take": True, "reason": "by hand"},
        {"do": "hand_over", "scope": "/tenant/alpha", "to": "robin"},
        {"do": "release", "scope": "/tenant/alpha"},
    ),
    history=1,
)

_USE = Rule(("discover", "read", "subscribe", "execute"), (PATH,))
_SEE = Rule(("discover", "read", "subscribe"), (PATH,))


def _make(config: LeasesConfig, host: FeatureHost) -> Feature:
    leases = Leases(config, host, changed=lambda: host.changed(PATH))
    requests = LeaseRequests(leases, host)
    control = LeaseControl(leases)
    shown = SystemResource(
        resource=_RESOURCE, view=requests.view, execute=requests.request, releases=releases
    )
    return Feature(
        resources=(shown,),
        guard=leases,
        services={CONTROL: control, HOLDERS: control},
        session_ended=leases.session_ended,
        rights_changed=leases.review,
        halted=leases.drop_on,
        reconfigure=leases.configure,
        running=leases.running,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Provide leases."""
    return [
        FeatureKind(
            "leases",
            LeasesConfig,
            _make,
            __doc__ or "",
            table=from_gateway,
            check=check,
            grants={"operator": (_USE,), "agent": (_USE,), "hub": (_SEE,)},
        )
    ]
