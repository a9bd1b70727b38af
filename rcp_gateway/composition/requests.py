"""What a request passes before its handler: the router, and the checks."""

from __future__ import annotations

from dataclasses import dataclass

from rcp_gateway.composition.base import Base
from rcp_gateway.composition.records import Records
from rcp_gateway.composition.tree import Tree
from rcp_gateway.features import Features
from rcp_requests.admission import Admission, Resolver
from rcp_requests.exempt import Exemptions
from rcp_requests.idempotency import Keys
from rcp_requests.long_bodies import LongBodies
from rcp_requests.router import RequestRouter

__all__ = ["Requests", "compose_requests"]


@dataclass(frozen=True, slots=True)
class Requests:
    """Parts that handlers share."""

    router: RequestRouter
    exempt: Exemptions
    long_bodies: LongBodies
    resolver: Resolver
    admission: Admission
    keys: Keys


def compose_requests(base: Base, tree: Tree, records: Records, features: Features) -> Requests:
    """Create the router without a handler, and the checks with the guards of the features."""
    resolver = Resolver(tree.registry)
    long_bodies = LongBodies(resolver, features.actions)
    admission = Admission(
        resolver,
        base.events,
        records.replies,
        base.shutdown,
        features.guards,
    )
    keys = Keys(records.store, base.loop, base.clock)
    keys.load(records.journal.find)
    exempt = Exemptions(features.releases)
    router = RequestRouter(
        base.settings,
        base.turns,
        base.counts,
        records.request_events,
        long_bodies,
        features.actions,
        exempt,
    )
    return Requests(router, exempt, long_bodies, resolver, admission, keys)
