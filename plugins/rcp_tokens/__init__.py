"""API keys that are created and revoked while the gateway runs: see `rcpd token`."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.role import BUILTIN_ROLES
from rcp_kernel.features import Feature, FeatureHost, FeatureKind
from rcp_kernel.hookspecs import hookimpl
from rcp_tokens.authenticator import TokenAuthenticator, TokenTables

__all__ = ["rcp_features"]


def _table(config: GatewayConfig) -> TokenTables:
    return TokenTables(tuple(config.tenant_names), (*BUILTIN_ROLES, *config.roles))


def _make(tables: TokenTables, host: FeatureHost) -> Feature:
    made = TokenAuthenticator(tables, host)
    return Feature(authenticator=made, reconfigure=made.reconfigure, running=made.running)


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Register the feature `tokens`."""
    return [FeatureKind("tokens", TokenTables, _make, __doc__ or "", table=_table)]
