"""Services and actions that clients offer: who offers what, which calls wait, what was answered.

For backends that put them where they can be called: into the tree, or on a ROS graph. Nothing of the
gateway is imported.
"""

from __future__ import annotations

from rcp_offers.call import Call, Report
from rcp_offers.messages import Answer, Offer, Take, Taken, Waiting
from rcp_offers.offered import Offered, Owner
from rcp_offers.offers import Offers
from rcp_offers.resources import OFFER, RESPOND, TAKE, control_resources

__all__ = [
    "OFFER",
    "RESPOND",
    "TAKE",
    "Answer",
    "Call",
    "Offer",
    "Offered",
    "Offers",
    "Owner",
    "Report",
    "Take",
    "Taken",
    "Waiting",
    "control_resources",
]
