"""The current configuration, replaced by a reload at run time."""

from __future__ import annotations

from rcp_kernel.config.file import GatewayConfig

__all__ = ["Settings"]


class Settings:
    """Holds the current configuration, for parts that read it on use."""

    __slots__ = ("config", "limits")

    def __init__(self, config: GatewayConfig) -> None:
        self.replace(config)

    def replace(self, config: GatewayConfig) -> None:
        """Apply another configuration."""
        self.config = config
        self.limits = config.limits
