"""The CAN backend's tests run on python-can's virtual bus; without it they are not collected."""

from __future__ import annotations

import importlib.util

import pytest

if importlib.util.find_spec("can") is None:
    collect_ignore_glob = ["test_*.py"]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture(autouse=True)
def patience_with_the_host(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no motor stop because a busy machine did not run the test for half a second.

    A motor does, as it should, and no option changes that. Where a gateway is to stand still, it does.
    Nor that rest, which takes three batches of reports, is not confirmed within 4 s.
    """
    monkeypatch.setattr("rcp_can.standstill._REST", 20.0)
    if "stands_still" not in request.fixturenames:
        monkeypatch.setattr("rcp_can.axis._FROZEN", 10.0)


@pytest.fixture
def stands_still() -> None:
    """A motor notices as soon as ever that its gateway stood still."""
