"""The configuration of leases: `lease_…` in `[safety]`."""

from __future__ import annotations

import msgspec

from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.role import check_pattern
from rcp_kernel.errors import ConfigError

__all__ = ["LeasesConfig", "check", "from_gateway"]


class LeasesConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The settings of leases; times in seconds."""

    required: tuple[str, ...]
    """Patterns of paths that only accept commands under a lease."""
    ttl: float
    """Duration of a lease whose request names none."""
    ttl_max: float


def from_gateway(config: GatewayConfig) -> LeasesConfig:
    """Read the settings from `[safety]`."""
    safety = config.safety
    return LeasesConfig(
        required=safety.lease_required, ttl=safety.lease_ttl, ttl_max=safety.lease_ttl_max
    )


def check(config: LeasesConfig, _gateway: GatewayConfig) -> None:
    """Check the settings for consistency.

    :raises ConfigError: a pattern is invalid, or the default duration exceeds the maximum.
    """
    for path in config.required:
        check_pattern(path, "[safety] lease_required")
    if config.ttl > config.ttl_max:
        raise ConfigError("[safety] lease_ttl is greater than lease_ttl_max")
