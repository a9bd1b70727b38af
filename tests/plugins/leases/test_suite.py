"""Leases keep what is asked of a feature."""

from __future__ import annotations

import rcp_leases
from rcp_gateway.testing import FeatureGateway, FeatureSuite

(KIND,) = rcp_leases.rcp_features()


class TestLeases(FeatureSuite):
    kind = KIND
    refusal = "lease_held"

    async def engage(self, gateway: FeatureGateway) -> None:
        body = {"do": "acquire", "scope": "/tenant/t"}
        await gateway.admin.request("execute", "/system/leases", body=body)

    async def release(self, gateway: FeatureGateway) -> None:
        body = {"do": "release", "scope": "/tenant/t"}
        await gateway.admin.request("execute", "/system/leases", body=body)
