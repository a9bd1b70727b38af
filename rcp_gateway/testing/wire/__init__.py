"""The wire suite: one body for each promise of the contract, run over any transport."""

from __future__ import annotations

from rcp_gateway.testing._suite import proves
from rcp_gateway.testing.wire._base import LOCAL, Wire, World, configuration
from rcp_gateway.testing.wire._commands import Commands
from rcp_gateway.testing.wire._control import Control
from rcp_gateway.testing.wire._discovery import Discovery
from rcp_gateway.testing.wire._envelopes import Envelopes
from rcp_gateway.testing.wire._once import Once
from rcp_gateway.testing.wire._opening import Opening
from rcp_gateway.testing.wire._pages import Pages
from rcp_gateway.testing.wire._paths import Paths
from rcp_gateway.testing.wire._plans import Planning
from rcp_gateway.testing.wire._qos import Quality
from rcp_gateway.testing.wire._reading import Reading
from rcp_gateway.testing.wire._record import Records
from rcp_gateway.testing.wire._requirements import REQUIREMENTS, Requirement
from rcp_gateway.testing.wire._robot import DEAD, ROBOT
from rcp_gateway.testing.wire._sessions import Sessions
from rcp_gateway.testing.wire._silence import Silence
from rcp_gateway.testing.wire._streams import Streams
from rcp_gateway.testing.wire._values import Values

__all__ = [
    "DEAD",
    "LOCAL",
    "REQUIREMENTS",
    "ROBOT",
    "Requirement",
    "TransportSuite",
    "Wire",
    "World",
    "configuration",
    "proves",
]


class TransportSuite(
    Paths,
    Opening,
    Envelopes,
    Once,
    Silence,
    Values,
    Reading,
    Pages,
    Commands,
    Control,
    Planning,
    Discovery,
    Streams,
    Quality,
    Sessions,
    Records,
):
    """Every promise of the contract, over the transport that a subclass connects by."""

    def test_no_test_of_the_suite_is_changed_without_a_reason(self) -> None:
        """See that nothing was overridden or taken out but under xfail with a reason."""
        assert [n for n in self.altered(TransportSuite) if self.applies(n)] == []

    @classmethod
    def applies(cls, name: str) -> bool:
        """Tell whether a test of the suite is about something that the transport offers."""
        ids: tuple[str, ...] = getattr(getattr(TransportSuite, name), "proves", ())
        return all(REQUIREMENTS[id_].needs <= cls.offers for id_ in ids)
