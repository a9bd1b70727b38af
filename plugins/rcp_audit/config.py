"""`[audit]`: how much of the audit log is kept."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_kernel.config.file import GatewayConfig

__all__ = ["AuditConfig", "AuditTables", "from_gateway"]


class AuditConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How much of the record is kept."""

    keep_days: Annotated[float, Meta(gt=0)] | None = 365.0
    """Older records are deleted."""
    keep_mb: Annotated[float, Meta(ge=1)] | None = 1024.0
    """The oldest records are deleted while the store is larger."""
    denials: Annotated[int, Meta(ge=1)] = 10
    """Refusals per second and principal with a record each; further ones are summed up."""


class AuditTables(msgspec.Struct, frozen=True):
    """What the feature takes of the configuration file."""

    audit: AuditConfig = AuditConfig()


def from_gateway(gateway: GatewayConfig) -> dict[str, object]:
    """Return the table, where it has always been in the file."""
    return {"audit": gateway.audit}
