"""A link follows its vehicle, also if it may only do so later."""

from __future__ import annotations

import pytest
from structlog.testing import capture_logs

from configuration import backend, key, table
from rcp_gateway.testing import ScriptedRobot, SteppedClock, eventually, scripted, serve
from rcp_ground_stations.config import StationConfig
from rcp_ground_stations.stations import Station
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host
from rcp_mavlink.dialect import dialect

pytestmark = pytest.mark.anyio
TOKEN = "station-station-station"
CONFIG = (
    backend("robot") + key("station", TOKEN, roles={"alpha": ["viewer"]}) + table("limits", paths=1)
)


def robot(host: Host) -> ScriptedRobot:
    names = ("event/mavlink/frame", "event/mavlink/other")
    return ScriptedRobot(host, *(Resource(name=n, description="Frames.", value=str) for n in names))


async def test_a_subscription_that_was_refused_is_tried_again(stepped: SteppedClock) -> None:
    given = StationConfig(link="udpin:127.0.0.1:0", robot="/tenant/alpha", token=TOKEN)
    with capture_logs() as logs:

        async def refused(count: int) -> None:
            async def told() -> bool:
                return len([one for one in logs if one["event"] == "vehicle_not_followed"]) == count

            await eventually(told, f"{count} refusals")

        async with serve(CONFIG, scripted(robot), clock=stepped.clock) as served:
            station = Station(given, served.server.client_api, dialect("ardupilotmega"))
            await station.open()
            try:
                await refused(1)
                stepped.advance(6)
                await refused(2)
            finally:
                await station.close()
