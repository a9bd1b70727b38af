"""JSON Web Tokens: clients authenticate with tokens signed by configured issuers, and people log in there."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_gateway.hookspecs import hookimpl
from rcp_jwt.authenticator import JwtAuthenticator
from rcp_jwt.code_flow import CodeFlow
from rcp_jwt.config import JwtConfig, JwtTables, check_tables
from rcp_kernel.clock import SYSTEM_CLOCK
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.features import Feature, FeatureHost, FeatureKind
from rcp_web.oidc import OIDC

__all__ = ["JwtConfig", "rcp_features"]


def _table(gateway: GatewayConfig) -> dict[str, object]:
    return {
        "jwt": list(gateway.jwt),
        "tenants": gateway.tenant_names,
        "effective_roles": gateway.effective_roles,
    }


def _check(tables: JwtTables, gateway: GatewayConfig) -> None:
    check_tables(tables, gateway)
    JwtAuthenticator(tables, SYSTEM_CLOCK)  # parses the keys


def _make(tables: JwtTables, host: FeatureHost) -> Feature:
    made = JwtAuthenticator(tables, host.clock, host.store("logins"), host.store("keys"))
    return Feature(
        authenticator=made,
        services={OIDC: CodeFlow(made, host.clock)},
        reconfigure=made.reconfigure,
        running=made.running,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Register the feature `jwt`."""
    return [
        FeatureKind(
            "jwt",
            JwtTables,
            _make,
            __doc__ or "",
            needs=("jwt", "cryptography"),
            table=_table,
            check=_check,
        )
    ]
