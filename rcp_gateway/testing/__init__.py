"""The public kit: an author subclasses a suite, and the suite, not the author, wrote the tests.

`BackendSuite`, `StopSuite` and `ProfileSuite` prove a robot's plugin, `TransportSuite` a client's wire, `AdapterSuite` a
translation, `FeatureSuite` a feature with its guard; `loopback` and `serve_backend` run a real gateway without a socket for tests of one's own. Needs pytest.
"""

from __future__ import annotations

import rcp_gateway.testing._asserts  # noqa: F401 # pyright: ignore[reportUnusedImport] - comes first
from rcp_gateway.testing._client import BOUND, Client, MemoryClient, Message, decode, encode
from rcp_gateway.testing._clock import SteppedClock, SteppedLoop, UnguardedLoop
from rcp_gateway.testing._scripted import Behaviour, ScriptedRobot, Take, scripted
from rcp_gateway.testing._serve import (
    ADMIN,
    OPERATOR,
    VIEWER,
    Life,
    Served,
    loopback,
    serve,
    serve_backend,
)
from rcp_gateway.testing._suite import Suite, eventually, proves
from rcp_gateway.testing.adapter import AdapterGateway, AdapterSuite
from rcp_gateway.testing.backend import BackendSuite, Goal, Robot
from rcp_gateway.testing.feature import FeatureGateway, FeatureSuite
from rcp_gateway.testing.profile import Body, ProfileRig, ProfileSuite
from rcp_gateway.testing.stop import StopRig, StopSuite
from rcp_gateway.testing.wire import REQUIREMENTS, Requirement, TransportSuite

__all__ = [
    "ADMIN",
    "BOUND",
    "OPERATOR",
    "REQUIREMENTS",
    "VIEWER",
    "AdapterGateway",
    "AdapterSuite",
    "BackendSuite",
    "Behaviour",
    "Body",
    "Client",
    "FeatureGateway",
    "FeatureSuite",
    "Goal",
    "Life",
    "MemoryClient",
    "Message",
    "ProfileRig",
    "ProfileSuite",
    "Requirement",
    "Robot",
    "ScriptedRobot",
    "Served",
    "SteppedClock",
    "SteppedLoop",
    "StopRig",
    "StopSuite",
    "Suite",
    "Take",
    "TransportSuite",
    "UnguardedLoop",
    "decode",
    "encode",
    "eventually",
    "loopback",
    "proves",
    "scripted",
    "serve",
    "serve_backend",
]
