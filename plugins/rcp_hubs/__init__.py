"""Hubs of a fleet: persons authenticated by a hub act on this gateway by its signed assertion."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_gateway.hookspecs import hookimpl
from rcp_hubs.authenticator import HubAuthenticator
from rcp_hubs.config import HubConfig, HubTables, check_tables, table_of
from rcp_hubs.revocation import REVOCATIONS
from rcp_kernel.features import Feature, FeatureHost, FeatureKind

__all__ = ["HubConfig", "rcp_features"]


def _make(tables: HubTables, host: FeatureHost) -> Feature:
    made = HubAuthenticator(tables, host)
    return Feature(
        authenticator=made,
        services={REVOCATIONS: made.take_revocations},
        reconfigure=made.reconfigure,
        running=made.running,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Register the feature `hubs`."""
    return [
        FeatureKind(
            "hubs",
            HubTables,
            _make,
            __doc__ or "",
            needs=("jwt", "cryptography"),
            table=table_of,
            check=check_tables,
        )
    ]
