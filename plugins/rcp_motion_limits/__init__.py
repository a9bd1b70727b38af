"""Motion limits by role: bounds, rates of change, fences, modes and conditions."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.role import BUILTIN_ROLES
from rcp_kernel.features import Feature, FeatureHost, FeatureKind
from rcp_motion_limits.config import (
    Bound,
    EnvelopeConfig,
    Fence,
    MotionLimitsConfig,
    check_envelopes,
)
from rcp_motion_limits.fence_watch import FenceWatch
from rcp_motion_limits.guard import MotionLimitGuard
from rcp_motion_limits.limits import MotionLimits

__all__ = ["Bound", "EnvelopeConfig", "Fence", "MotionLimitsConfig", "rcp_features"]


def _table(gateway: GatewayConfig) -> dict[str, object]:
    return {"envelopes": list(gateway.envelopes)}


def _check(config: MotionLimitsConfig, gateway: GatewayConfig) -> None:
    roles = {**BUILTIN_ROLES, **gateway.roles}
    check_envelopes(config.envelopes, roles, gateway.tenant_names)


def _make(config: MotionLimitsConfig, host: FeatureHost) -> Feature:
    limits = MotionLimits(host)
    guard = MotionLimitGuard(limits, FenceWatch(limits, host))
    guard.configure(config)
    return Feature(
        guard=guard,
        observer=guard,
        foresee=guard.foresee,
        dry_run=guard.dry_run,
        describe=limits.describe,
        status=guard.status,
        reconfigure=guard.configure,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Register the feature `motion_limits`."""
    return [
        FeatureKind(
            "motion_limits",
            MotionLimitsConfig,
            _make,
            __doc__ or "",
            table=_table,
            check=_check,
        )
    ]
