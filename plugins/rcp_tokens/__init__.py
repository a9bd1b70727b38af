"""API keys that are created and revoked while the gateway runs: see `rcpd token`."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.role import BUILTIN_ROLES
from rcp_kernel.features import Feature, FeatureHost, FeatureKind, SystemResource
from rcp_kernel.model import Operation, Resource
from rcp_tokens.authenticator import TokenAuthenticator, TokenTables
from rcp_tokens.directory import KeyDirectory
from rcp_tokens.messages import ListedKey, Revocation

__all__ = ["rcp_features"]


def _table(config: GatewayConfig) -> TokenTables:
    return TokenTables(tuple(config.tenant_names), (*BUILTIN_ROLES, *config.roles))


_RESOURCE = Resource(
    name="service/keys",
    description="Keys that were created while the gateway runs (`rcpd token create`); `execute` revokes one.",
    value=list[ListedKey],
    input=Revocation,
    output=ListedKey,
    operations=Operation.READ | Operation.SUBSCRIBE | Operation.EXECUTE,
    examples=({"revoke": "t-5f0c93aa"},),
    history=1,
)


def _make(tables: TokenTables, host: FeatureHost) -> Feature:
    made = TokenAuthenticator(tables, host)
    keys = KeyDirectory(made, host)
    return Feature(
        resources=(SystemResource(resource=_RESOURCE, view=keys.view, execute=keys.revoke),),
        authenticator=made,
        reconfigure=made.reconfigure,
        running=made.running,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Register the feature `tokens`."""
    return [FeatureKind("tokens", TokenTables, _make, __doc__ or "", table=_table)]
