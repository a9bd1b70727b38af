"""A thread that calculates keeps no request waiting for long."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from configuration import backend
from rcp_kernel.config.file import parse
from rcpd.serve import run


@pytest.fixture
def _switch_interval() -> Iterator[None]:
    before = sys.getswitchinterval()
    yield
    sys.setswitchinterval(before)


@pytest.mark.usefixtures("_switch_interval")
def test_a_gateway_has_threads_take_short_turns() -> None:
    sys.setswitchinterval(0.005)
    with pytest.raises(SystemExit):  # there is no such backend
        run(parse(backend("a", use="none"), "test"), "test", None, None)
    assert sys.getswitchinterval() <= 0.001
