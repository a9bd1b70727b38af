"""Two tenants with people in them, for tests of quotas, and what counts a session."""

from __future__ import annotations

from configuration import backend, key, table
from kernel.world import CONFIG
from rcp_kernel.sessions.session import Session
from rcp_quotas.bucket import TokenBucket
from rcp_quotas.usage import QuotaUsage

LEVEL = "/tenant/alpha/sensor/level"
KEYS = (
    key("ann", "ann-ann-ann-ann-ann", roles={"alpha": "operator"})
    + key("bob", "bob-bob-bob-bob-bob", roles={"beta": "operator"})
    + key("agent", "agent-agent-agent-agent", roles={"alpha": "agent"})
    + table("tenants.alpha")
    + table("tenants.beta")
)
SECOND = backend("second", "beta")
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
