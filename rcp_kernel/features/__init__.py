"""Features: extensions of the gateway itself, what they declare and the host that each receives."""

from __future__ import annotations

from rcp_kernel.features.action import Action, ActionHost, ActionRun
from rcp_kernel.features.feature import Durability, Feature, FeatureKind, StatusPart
from rcp_kernel.features.guard import Call, Guard, Slot
from rcp_kernel.features.host import FeatureHost
from rcp_kernel.features.observer import CommandObserver
from rcp_kernel.features.resource import Filter, Pages, Service, SystemResource, View
from rcp_kernel.features.robots import RobotConditions, Robots
from rcp_kernel.features.services import ServiceKey
from rcp_kernel.features.sessions import SessionDirectory
from rcp_kernel.sessions.account import SessionAccount
from rcp_kernel.sessions.accounting import Accounting
from rcp_kernel.tree.scope import Scope

__all__ = [
    "Accounting",
    "Action",
    "ActionHost",
    "ActionRun",
    "Call",
    "CommandObserver",
    "Durability",
    "Feature",
    "FeatureHost",
    "FeatureKind",
    "Filter",
    "Guard",
    "Pages",
    "RobotConditions",
    "Robots",
    "Scope",
    "Service",
    "ServiceKey",
    "SessionAccount",
    "SessionDirectory",
    "Slot",
    "StatusPart",
    "SystemResource",
    "View",
]
