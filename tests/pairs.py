"""Which of a stop suite's scopes are tried with which of its situations."""

from __future__ import annotations

import os
import zlib
from pathlib import Path

import pytest

from rcp_gateway.testing import StopSuite
from rcp_gateway.testing.stop import SCOPES
from rcp_gateway.testing.stop._situations import SITUATIONS

__all__ = ["left_out"]

_ALL = os.environ.get("RCP_STOP_PAIRS") == "all"
_SLOW = Path(__file__).parent / "backends"


def left_out(item: pytest.Item) -> bool:
    """Tell whether a test repeats what others prove.

    The simulated rover is stopped in each situation by each scope. What backends make of a situation
    does not depend on who else is stopped: each of the others is tried in each situation with one
    scope, in turns. So all pairs are there of situation, scope and backend. With
    RCP_STOP_PAIRS=all nothing is left out: a release wants that.
    """
    if _ALL or not isinstance(item, pytest.Function) or not item.path.is_relative_to(_SLOW):
        return False
    suite = item.cls
    chosen = getattr(item, "callspec", None)
    if suite is None or not issubclass(suite, StopSuite) or chosen is None:
        return False
    if not {"situation", "scope"} <= chosen.params.keys():
        return False
    first = zlib.crc32(suite.__name__.encode())
    turn = (first + list(SITUATIONS).index(chosen.params["situation"])) % len(SCOPES)
    return chosen.params["scope"] != list(SCOPES)[turn]
