"""The audit log keeps what is asked of a feature."""

from __future__ import annotations

import rcp_audit
from rcp_gateway.testing import FeatureSuite

(KIND,) = rcp_audit.rcp_features()


class TestAudit(FeatureSuite):
    kind = KIND
