"""The configuration of `[audit]`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_kernel.config.file import GatewayConfig

__all__ = ["AuditConfig", "AuditTables", "from_gateway"]


class AuditConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Retention of the audit log, and the limit on refusals."""

    keep_days: Annotated[float, Meta(gt=0)] | None = 365.0
    """Older records are deleted."""
    keep_mb: Annotated[float, Meta(ge=1)] | None = 1024.0
    """The oldest records are deleted while the store is larger."""
    denials: Annotated[int, Meta(ge=1)] = 10
    """Refusals per second and principal with individual records; further ones are summarised."""


class AuditTables(msgspec.Struct, frozen=True):
    """The tables of the configuration file that the feature reads."""

    audit: AuditConfig = AuditConfig()


def from_gateway(gateway: GatewayConfig) -> dict[str, object]:
    """Return the `[audit]` table."""
    return {"audit": gateway.audit}
