"""What a test does to the process's log ends with it; the second test here looks for what the first has left."""

from __future__ import annotations

import logging

import structlog
from structlog.testing import capture_logs

from rcp_gateway.log import configure


def test_a_gateway_logs_nothing_but_what_is_critical() -> None:
    configure("critical", "json")
    with capture_logs() as said:
        structlog.get_logger("test").error("unheard")
    assert said == []


def test_the_next_test_hears_of_everything() -> None:
    with capture_logs() as said:
        structlog.get_logger("test").info("heard")
    assert [one["event"] for one in said] == ["heard"]
    assert logging.getLogger().level == logging.WARNING
