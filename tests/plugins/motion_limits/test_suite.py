"""Motion limits keep what is asked of a feature."""

from __future__ import annotations

from typing import Any

import msgspec

import rcp_motion_limits
from rcp_gateway.testing import FeatureGateway, FeatureSuite

(KIND,) = rcp_motion_limits.rcp_features()


class TestMotionLimits(FeatureSuite):
    kind = KIND
    refusal = "mode_forbids"

    def _limit(self, gateway: FeatureGateway, *envelopes: dict[str, Any]) -> None:
        """Reload with other envelopes."""
        kernel = gateway.served.server.gateway
        config = msgspec.structs.replace(kernel.settings.config, envelopes=envelopes)
        kernel.reconfigure(config, self.features(config))

    async def engage(self, gateway: FeatureGateway) -> None:
        self._limit(gateway, {"name": "never", "paths": ["/**"], "modes": ["NEVER"]})

    async def release(self, gateway: FeatureGateway) -> None:
        self._limit(gateway)
