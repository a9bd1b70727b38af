"""The configuration in force: what a reload replaces while everything else goes on."""

from __future__ import annotations

from rcp_kernel.config.file import GatewayConfig

__all__ = ["Settings"]


class Settings:
    """Holds the present configuration, for parts that follow it without being told."""

    __slots__ = ("config", "limits")

    def __init__(self, config: GatewayConfig) -> None:
        self.replace(config)

    def replace(self, config: GatewayConfig) -> None:
        """Put another configuration into force."""
        self.config = config
        self.limits = config.limits
