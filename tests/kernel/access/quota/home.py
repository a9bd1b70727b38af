"""Two tenants with people in them, for tests of quotas."""

from __future__ import annotations

from kernel.world import CONFIG

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
