"""Two tenants with people in them, for tests of quotas, and what counts a session."""

from __future__ import annotations

from kernel.world import CONFIG
from rcp_kernel.sessions.session import Session
from rcp_quotas.bucket import TokenBucket
from rcp_quotas.usage import QuotaUsage

LEVEL = "/tenant/alpha/sensor/level"
KEYS = """
[[keys]]
name = "ann"
roles = { alpha = "operator" }
key = "ann-ann-ann-ann-ann"

[[keys]]
name = "bob"
roles = { beta = "operator" }
key = "bob-bob-bob-bob-bob"

[[keys]]
name = "agent"
roles = { alpha = "agent" }
key = "agent-agent-agent-agent"

[tenants.alpha]
[tenants.beta]
"""
SECOND = """
[[backends]]
use = "robot"
name = "second"
tenant = "beta"
"""
ANN, BOB, AGENT = "ann-ann-ann-ann-ann", "bob-bob-bob-bob-bob", "agent-agent-agent-agent"
SLOW = "[tenants.alpha.quota]\nrequests = 0.01\nburst = 3\n"


def at_home(quotas: str) -> str:
    return CONFIG + KEYS + quotas


def usages_of(session: Session) -> tuple[QuotaUsage, ...]:
    """Return what a session is counted by."""
    account = session.account
    if account is None:
        return ()
    assert isinstance(account, TokenBucket)
    return account.usages
