"""The wire suite: one body for each promise of the contract, run over any transport."""

from __future__ import annotations

from rcp_kernel.testing._suite import proves
from rcp_kernel.testing.wire._base import World
from rcp_kernel.testing.wire._commands import Commands
from rcp_kernel.testing.wire._discovery import Discovery
from rcp_kernel.testing.wire._envelopes import Envelopes
from rcp_kernel.testing.wire._once import Once
from rcp_kernel.testing.wire._paths import Paths
from rcp_kernel.testing.wire._qos import Quality
from rcp_kernel.testing.wire._reading import Reading
from rcp_kernel.testing.wire._requirements import REQUIREMENTS, Requirement
from rcp_kernel.testing.wire._sessions import Sessions
from rcp_kernel.testing.wire._silence import Silence
from rcp_kernel.testing.wire._streams import Streams
from rcp_kernel.testing.wire._values import Values

__all__ = ["REQUIREMENTS", "Requirement", "TransportSuite", "World", "proves"]


class TransportSuite(
    Paths,
    Envelopes,
    Once,
    Silence,
    Values,
    Reading,
    Commands,
    Discovery,
    Streams,
    Quality,
    Sessions,
):
    """Every promise of the contract, over the transport that a subclass connects by."""

    @classmethod
    def wire_tests(cls) -> list[str]:
        """List the tests that apply to what the transport offers."""
        return [name for name in dir(cls) if name.startswith("test_") and getattr(cls, name)]
