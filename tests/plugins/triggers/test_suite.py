"""Triggers keep what is asked of a feature."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import rcp_triggers
from rcp_gateway.testing import FeatureSuite

(KIND,) = rcp_triggers.rcp_features()


class TestTriggers(FeatureSuite):
    kind = KIND
    options: ClassVar[Mapping[str, Any]] = {
        "rules": {
            "limit": {"robot": "/tenant/t", "when": "time.hour >= 0", "alarm": True},
        }
    }
