"""Frames that only a robot's own gateway knows are for those who may know where the robot is."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Callable
from functools import partial
from typing import Any

import msgspec
import pytest

from configuration import backend, configuration, key, role, rule, table
from rcp_gateway.testing import MemoryClient, ScriptedRobot, SteppedClock, scripted, serve
from rcp_gateway.testing._serve import Served
from rcp_kernel.clock import SYSTEM_CLOCK, Clock, now
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.spi import FrameWatch, Host
from rcp_kernel.types import AngularVelocity, LinearVelocity, PoseStamped
from rcp_kernel.values import Encoding
from rcp_profiles.messages import TwistStamped

pytestmark = pytest.mark.anyio
ADMIN, BLIND, PARTLY, AWAKE = (f"{n}-{n}-{n}" for n in ("admin", "blind", "partly", "awake"))
POSE, VELOCITY, GAIN = "/sensor/r1/pose", "/sensor/r1/velocity", "sensor/r1/gain"
_ALL = rule("discover read subscribe", "/**")
CONFIG = configuration(
    backend(use="hub"),
    role("blind", _ALL, deny=[rule("discover", POSE)]),
    role("partly", _ALL, deny=[rule("discover", "/sensor/r1/left/pose")]),
    role(
        "awake",
        rule("discover read subscribe", VELOCITY, f"/{GAIN}"),
        rule("read", POSE, "/sensor/r1/left/pose", when="sensor.r1.gain > 0.5"),
    ),
    key("admin", ADMIN, roles={"*": ["admin"]}),
    key("blind", BLIND, roles={"alpha": ["blind"]}),
    key("partly", PARTLY, roles={"alpha": ["partly"]}),
    key("awake", AWAKE, roles={"alpha": ["awake"]}),
)


class _Converted(msgspec.Struct, frozen=True):
    """A value as a robot's own gateway sends it."""

    data: bytes
    seq: int
    timestamp: int
    encoding = Encoding.MSGPACK

    def decode(self) -> Any:
        return msgspec.msgpack.decode(self.data)


class Hub(ScriptedRobot):
    """A robot whose own gateway converts: `sends` does as it would."""

    has_gateways = True

    def __init__(self, host: Host) -> None:
        self.asked: list[str] = []
        """The names that were read in a frame."""
        self.streams: list[FrameWatch] = []
        add = partial(Resource, robot="r1")
        super().__init__(
            host,
            add(name="sensor/r1/pose", description="Where.", value=PoseStamped, live=True),
            add(name="sensor/r1/left/pose", description="Arm.", value=PoseStamped, live=True),
            add(name="sensor/r1/velocity", description="Speed.", value=TwistStamped, live=True),
            add(name=GAIN, description="A number.", value=float, live=True),
        )

    def frames_of(self, name: str) -> tuple[str, ...]:
        return ("map", "base_link")

    async def read_in_frame(self, name: str, frame: str) -> Any:
        self.asked.append(name)
        return _converted(1)

    def watch_in_frame(self, name: str, watch: FrameWatch) -> Callable[[], None]:
        self.streams.append(watch)
        return lambda: self.streams.remove(watch)

    def sends(self, seq: int) -> None:
        for watch in tuple(self.streams):
            watch.publish(_converted(seq))


def _converted(seq: int) -> _Converted:
    return _Converted(msgspec.msgpack.encode({"frame_id": "map", "seq": seq}), seq, now())


@pytest.fixture
async def served(request: pytest.FixtureRequest) -> AsyncGenerator[Served]:
    clock: Clock = SYSTEM_CLOCK
    if "stepped" in request.fixturenames:
        clock = request.getfixturevalue("stepped").clock
    async with serve(parse(CONFIG, "test"), scripted(Hub, "hub"), clock=clock) as served:
        yield served


def hub_of(served: Served) -> Hub:
    found: Any = served.life.backend
    return getattr(found, "inner", found)


async def _read(client: MemoryClient, path: str, **more: Any) -> dict[str, Any]:
    return await client.request("read", path, body={"frame": "map", **more})


@pytest.mark.parametrize("who", [BLIND, PARTLY])
async def test_who_may_not_read_every_pose_gets_no_value_in_a_frame(
    served: Served, who: str
) -> None:
    client, hub = served.client(who), hub_of(served)
    refused = (await _read(client, VELOCITY))["error"]
    assert (refused["code"], refused["details"]["frames"]) == ("invalid_value", []), refused
    assert "map" in refused["message"]
    found = await _read(client, "/sensor/**")
    items = {one["path"]: one for one in found["body"]}
    assert items["/tenant/alpha/sensor/r1/velocity"]["error"]["code"] == "invalid_value", items
    again = await client.request("subscribe", VELOCITY, body={"frame": "map"})
    assert again["error"]["message"] == refused["message"], again
    many = await client.subscribe("/sensor/**", frame="map")
    told = await client.notice("no_transform")
    assert (told["id"], told["message"]) == (many, refused["message"])
    assert (hub.asked, hub.streams) == ([], []), "the robot's gateway is not even asked"
    shown = await client.request("discover", VELOCITY)
    assert "frames" not in shown["body"]["resources"][0]


async def test_who_may_read_the_poses_gets_what_the_robots_gateway_sends(served: Served) -> None:
    client, hub = served.client(ADMIN), hub_of(served)
    reply = await _read(client, VELOCITY)
    assert reply["body"]["frame_id"] == "map", reply
    id_ = await client.subscribe(VELOCITY, frame="map")
    hub.sends(7)
    assert (await client.update(id_))["body"]["seq"] == 7


async def test_a_condition_for_the_pose_holds_for_each_value_in_a_frame(served: Served) -> None:
    client, hub = served.client(AWAKE), hub_of(served)
    hub.host.publish(GAIN, 1.0)
    id_ = await client.subscribe(VELOCITY, frame="map")
    hub.sends(1)
    assert (await client.update(id_))["body"]["seq"] == 1
    hub.host.publish(GAIN, 0.0)
    hub.sends(2)
    later = await client.until(lambda m: m["type"] in ("update", "notice"))
    assert later.get("code") == "no_transform", later
    assert (await _read(client, VELOCITY))["error"]["message"] == later["message"]
    hub.streams[0].missing("the pose of the robot is unknown")
    hub.host.publish(GAIN, 1.0)
    hub.sends(3)
    after = await client.until(lambda m: m["type"] in ("update", "notice"))
    assert after.get("body", {}).get("seq") == 3, "nor is it told what the robot's gateway says"


async def test_without_the_feature_no_value_in_a_frame_is_asked_of_a_robot() -> None:
    text = CONFIG + table("features", frames=False)
    async with serve(parse(text, "test"), scripted(Hub, "hub")) as served:
        reply = await _read(served.client(ADMIN), VELOCITY)
        assert reply["error"]["code"] == "filter_unsupported", reply
        assert hub_of(served).asked == []


async def test_a_deadline_in_a_frame_is_missed_although_the_plain_value_comes(
    served: Served, stepped: SteppedClock
) -> None:
    client, hub = served.client(ADMIN), hub_of(served)
    speed = TwistStamped(LinearVelocity(x=1.0), AngularVelocity(z=0.5))
    plain = await client.subscribe(VELOCITY, initial=False)
    framed = await client.subscribe(VELOCITY, frame="map", qos={"deadline": 60.0})
    hub.sends(1)
    await client.update(framed)
    stepped.advance(100)
    hub.host.publish("sensor/r1/velocity", speed)
    await client.update(plain)
    told = await client.notice("deadline_missed")
    assert (told["id"], told["path"]) == (framed, f"/tenant/alpha{VELOCITY}")
