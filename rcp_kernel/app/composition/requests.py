"""What a request passes before its handler: the router, and the checks."""

from __future__ import annotations

from dataclasses import dataclass

from rcp_kernel.app.composition.base import Base
from rcp_kernel.app.composition.records import Records
from rcp_kernel.app.composition.tree import Tree
from rcp_kernel.app.features import Features
from rcp_kernel.requests.admission import Admission, Resolver
from rcp_kernel.requests.exempt import Exemptions
from rcp_kernel.requests.idempotency import Keys
from rcp_kernel.requests.long_bodies import LongBodies
from rcp_kernel.requests.router import RequestRouter

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
