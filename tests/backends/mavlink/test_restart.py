"""A reboot is over when the vehicle has restarted, not when it still goes on after it has accepted."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from backends.mavlink.puppet import Puppet, station
from rcp_mavlink import restart

_GOES_ON = 1.5  # s after the acknowledgement, with heartbeats


class Restarting(Puppet):
    """It accepts a reboot, goes on, and then restarts in one way or another."""

    def __init__(self, way: str) -> None:
        super().__init__()
        self.way, self.restarted = way, False
        self.results = {246: self._reboot}

    def _reboot(self, _: Any) -> int:
        if self.way != "not at all":
            asyncio.get_running_loop().call_later(_GOES_ON, self._go)
        return 0

    def _go(self) -> None:
        self.quiet = self.way != "by its clock"
        pause = 4.0 if self.quiet else 0.0
        asyncio.get_running_loop().call_later(pause, self._come)

    def _come(self) -> None:
        self.quiet, self.restarted = False, True
        if self.way == "by its clock":
            self.booted = asyncio.get_running_loop().time()


@pytest.mark.parametrize("service", ["service/reboot", "service/reset_system"])
@pytest.mark.parametrize(
    ("way", "silence"), [("by its clock", 9.0), ("by a pause", 9.0), ("by a pause", 1.5)]
)
async def test_a_reboot_ends_when_the_vehicle_has_restarted(
    way: str, silence: float, service: str
) -> None:
    puppet = Restarting(way)
    async with station(puppet, silence=silence) as found:
        reply = await found.do(service)
        assert reply["status"] == "completed", reply
        assert puppet.restarted


async def test_a_vehicle_that_only_accepts_a_reboot_has_not_rebooted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(restart, "_COMING_BACK", 2.0)
    async with station(Restarting("not at all")) as found:
        reply = await found.do("service/reboot")
        assert (reply["status"], reply["error"]["code"]) == ("failed", "device_timeout"), reply
        assert "has not restarted" in reply["message"]
