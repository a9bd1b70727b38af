"""The ROS 2 backend keeps what the house asks of a backend, with a peer in its own process."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, ClassVar

import pytest
import rclpy.experimental.events_executor  # noqa: F401 - half a second that is not tested here

import rcp_ros2
from backends.ros2.robot import Peer, fresh_domain
from rcp_gateway.testing import BackendSuite, Goal, eventually

DOMAIN = fresh_domain()
PEER = Peer(DOMAIN, shared_memory=False)  # killed again and again, and started anew
MESH = "package://peer_description/base.stl"
_QUIET = 4  # times in a row that the peer must tell the same


@pytest.fixture(scope="module", autouse=True)
def _end() -> Iterator[None]:
    yield
    PEER.stop()


@pytest.mark.paired  # beside several other tests the peer was once not discovered within 20 s
class TestRos2(BackendSuite):
    kind = next(iter(rcp_ros2.rcp_backends()))
    config: ClassVar[Mapping[str, Any]] = {
        "domain_id": DOMAIN,
        "timeout": 0.8,
        "silence": 1.0,
        "assets": {
            "paths": {"peer_description": str(Path(__file__).with_name("peer_description"))}
        },
        "map": {
            "/sensor/odom": {"topic": "/odom", "unit": "1"},
            "/sensor/pose": {"topic": "/odom", "field": "pose.pose"},
            "/sensor/description": {"topic": "/robot_description"},
            "/actuator/cmd_vel": {"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist"},
            "/event/fault": {"topic": "/faults"},
            "/service/reset": {"service": "/reset"},
            "/action/fibonacci": {"action": "/fibonacci", "unit": "1"},
            "/param/speed_limit": {"node": "/peer", "parameter": "max_speed", "unit": "m/s"},
            "/param/mode": {"node": "/peer", "parameter": "mode"},
        },
    }

    @asynccontextmanager
    async def twin(self) -> AsyncGenerator[Peer]:
        if not PEER.runs:
            PEER.start()
        yield PEER

    async def truth(self, name: str) -> Any:
        key = {"param/speed_limit": "max_speed", "actuator/cmd_vel": "twist"}
        found = [PEER.truth()[key.get(name, name.partition("/")[2])]]
        # A command is on its way, and nothing tells when it has arrived: not before it is quiet.
        while len(found) < _QUIET or any(one != found[-1] for one in found[-_QUIET:]):
            await asyncio.sleep(0.05)
            found.append(PEER.truth()[key.get(name, name.partition("/")[2])])
        return found[-1]

    async def confirms(self, name: str, result: Any) -> bool:
        if name == "service/reset":
            return result["success"]
        if name == "service/assets/fetch":
            return result["media_type"] == "model/stl"
        return result["sequence"] == PEER.truth()["result"]

    async def at_rest(self) -> bool:
        truth = PEER.truth()
        still = all(v == 0 for part in truth["twist"].values() for v in part.values())
        return still and truth["running"] == 0

    def goals(self) -> Mapping[str, Goal]:
        return {
            "action/fibonacci": Goal(good={"order": 3}, bad={"order": -1}, long={"order": 500}),
            "service/reset": Goal(good=None),
            "service/assets/fetch": Goal(
                good={"uri": MESH}, bad={"uri": MESH + ".stl"}, local=True
            ),
        }

    def values(self, name: str) -> Sequence[Any]:
        return {
            "actuator/cmd_vel": ({"linear": {"x": 0.4}}, {"angular": {"z": 0.2}}),
            "param/speed_limit": (0.5, 1.0),
            "param/mode": ("auto", "manual"),
        }[name]

    @asynccontextmanager
    async def served_by_device(self) -> AsyncGenerator[Any]:
        async with super().served_by_device() as robot:
            # Discovery takes 0.2 s mostly and 3 s now and then: it is not what is tested.
            await eventually(self.discovered, "the peer is discovered")
            yield robot

    async def discovered(self) -> bool:
        catalog = self.backend.catalog
        pulse = catalog.shared.pulses.of("/peer")
        named = all(type(b).__name__ != "Absent" for b in catalog.bindings.values())
        return catalog.complete.is_set() and named and pulse is not None and pulse.answers > 0

    @asynccontextmanager
    async def refusing(self, name: str) -> AsyncGenerator[None]:
        PEER.refuse({"param/speed_limit": "max_speed"}.get(name, name.partition("/")[2]))
        yield
        PEER.refuse("")

    async def break_link(self) -> None:
        PEER.kill()

    async def mend_link(self) -> None:
        PEER.start()
