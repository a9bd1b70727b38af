"""The configuration of approvals: `[safety] approval_ttl`, and `approve` of each role."""

from __future__ import annotations

import msgspec

from rcp_kernel.config.file import GatewayConfig

__all__ = ["ApprovalsConfig", "from_gateway"]


class ApprovalsConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The settings of approvals."""

    ttl: float
    """Time in s for which an approval can be decided and used."""
    asked: bool
    """Whether any role has commands that require approval."""


def from_gateway(config: GatewayConfig) -> ApprovalsConfig:
    """Return the settings from their places in the file."""
    required = any(role.approve for role in config.roles.values())
    return ApprovalsConfig(ttl=config.safety.approval_ttl, asked=required)
