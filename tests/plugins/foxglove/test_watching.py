"""What a viewer sees: channels with their schemas, and messages byte by byte."""

from __future__ import annotations

import asyncio
import base64
import json
import struct
import time
from typing import Any, ClassVar

import msgspec
import pytest
from websockets.exceptions import InvalidStatus

from plugins.foxglove.rig import ADMIN, OPERATOR, WATCHER, Picture, Serialised, Site, site
from plugins.foxglove.viewer import Viewer, viewing
from rcp_foxglove.config import FoxgloveConfig
from rcp_foxglove.endpoint import open_foxglove
from rcp_kernel.errors import PluginError
from rcp_kernel.model import Resource
from rcp_kernel.types import Point, PoseStamped, quantity
from rcp_kernel.values import Encoding

pytestmark = pytest.mark.anyio


async def test_the_first_message_says_who_serves_and_what(gateway: Site, viewer: Viewer) -> None:
    info = await viewer.op("serverInfo")
    assert set(info["capabilities"]) == {
        "clientPublish",
        "parameters",
        "parametersSubscribe",
        "services",
        "connectionGraph",
        "assets",
    }
    assert info["supportedEncodings"] == ["json", "cdr"]
    assert info["sessionId"]
    assert viewer.socket.subprotocol == "foxglove.sdk.v1"


async def test_the_older_subprotocol_is_spoken_too(gateway: Site) -> None:
    async with viewing(gateway.url, OPERATOR, "foxglove.websocket.v1") as viewer:
        assert viewer.socket.subprotocol == "foxglove.websocket.v1"
        await viewer.channel("/sensor/level")


async def test_a_client_of_another_protocol_is_told_what_this_is(gateway: Site) -> None:
    with pytest.raises(InvalidStatus) as refused:
        async with viewing(gateway.url, OPERATOR, "rcp.v1.json"):
            pass
    assert refused.value.response.status_code == 400
    assert b"foxglove.sdk.v1" in (refused.value.response.body or b"")


async def test_a_value_comes_as_json_with_its_schema(gateway: Site, viewer: Viewer) -> None:
    channel = await viewer.subscribe("/sensor/level", 4)
    assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema")
    assert json.loads(channel["schema"])["type"] == "number"
    moment, payload = await viewer.message(4)
    assert json.loads(payload) == 1.25
    assert abs(moment / 1e9 - time.time()) < 600
    gateway.robot.measure("sensor/level", 2.5)
    assert json.loads((await viewer.message(4))[1]) == 2.5


async def test_a_robots_own_bytes_pass_through_undecoded(gateway: Site, viewer: Viewer) -> None:
    channel = await viewer.subscribe("/range", 9)
    assert channel["encoding"] == "cdr"
    assert channel["schemaEncoding"] == "ros2msg"
    assert channel["schemaName"] == "pkg/msg/Range"
    assert channel["schema"] == "float64 range"
    data = b"\x00\x01\x00\x00" + struct.pack("<d", 4.5)
    before = Serialised.decoded
    gateway.robot.host.publish("sensor/range", Serialised(data))
    assert (await viewer.message(9))[1] == data
    assert Serialised.decoded == before


async def test_a_pose_comes_as_the_type_that_panels_draw(gateway: Site, viewer: Viewer) -> None:
    channel = await viewer.subscribe("/sensor/pose")
    assert channel["schemaName"] == "foxglove.PoseInFrame"
    gateway.robot.measure(
        "sensor/pose",
        PoseStamped(Point(1.0, 2.0), frame_id="map", timestamp="2026-05-29T14:12:04.5Z"),
    )
    value = json.loads((await viewer.message())[1])
    assert value["timestamp"] == {"sec": 1780063924, "nsec": 500_000_000}
    assert value["frame_id"] == "map"
    assert value["pose"]["position"] == {"x": 1.0, "y": 2.0, "z": 0.0}


class Passed(msgspec.Struct):
    """A value as a hub passes it on."""

    data: bytes
    seq: int
    timestamp: int
    encoding: ClassVar[Encoding] = Encoding.MSGPACK

    def decode(self) -> Any:
        return msgspec.msgpack.decode(self.data)


async def test_a_pose_that_passed_a_hub_is_drawn_too(gateway: Site, viewer: Viewer) -> None:
    await viewer.subscribe("/sensor/pose")
    data = msgspec.msgpack.encode(PoseStamped(Point(1.0, 2.0)))
    gateway.robot.host.publish("sensor/pose", Passed(data, 7, 1_780_063_924_000_000_000))
    value = json.loads((await viewer.message())[1])
    assert value["timestamp"] == {"sec": 1_780_063_924, "nsec": 0}
    assert value["pose"]["position"]["y"] == 2.0


async def test_an_image_comes_as_the_type_that_panels_draw(gateway: Site, viewer: Viewer) -> None:
    channel = await viewer.subscribe("/sensor/camera")
    assert channel["schemaName"] == "foxglove.CompressedImage"
    gateway.robot.measure("sensor/camera", Picture(2, 2, b"\x89PNG..."))
    value = json.loads((await viewer.message())[1])
    assert (value["format"], base64.b64decode(value["data"])) == ("png", b"\x89PNG...")


async def test_rights_decide_which_channels_exist(gateway: Site) -> None:
    async with viewing(gateway.url, WATCHER) as viewer:
        await viewer.channel("/sensor/level")
        assert set(viewer.channels) == {"/sensor/level"}
        await viewer.send("subscribe", subscriptions=[{"id": 1, "channelId": 10_000}])
        status = await viewer.op("status")
        assert "10000" in status["message"]
        assert not viewer.services


async def test_without_a_key_nobody_is_let_in(gateway: Site) -> None:
    for token in (None, "no-key-of-anybody"):
        with pytest.raises(InvalidStatus) as refused:
            async with viewing(gateway.url, token):
                pass
        assert refused.value.response.status_code == 401


async def test_a_key_in_the_url_is_refused_unless_configured(gateway: Site) -> None:
    with pytest.raises(InvalidStatus) as refused:
        async with viewing(f"{gateway.url}?token={OPERATOR}"):
            pass
    assert refused.value.response.status_code == 400
    async with site(token_in_url=True) as other, viewing(f"{other.url}?token={OPERATOR}") as viewer:
        await viewer.channel("/sensor/level")


async def test_channels_come_and_go_with_resources(gateway: Site, viewer: Viewer) -> None:
    await viewer.subscribe("/sensor/level")
    gateway.robot.add(Resource(name="sensor/new", description="New.", value=quantity("m")))
    await viewer.channel("/sensor/new")
    gateway.robot.remove("sensor/new", "sensor/level")
    await viewer.until(lambda: not {"/sensor/new", "/sensor/level"} & set(viewer.channels))


async def test_a_channel_that_returns_unchanged_has_its_number(
    gateway: Site, viewer: Viewer
) -> None:
    new = Resource(name="sensor/new", description="New.", value=quantity("m"))
    gateway.robot.add(new)
    first = await viewer.channel("/sensor/new")
    gateway.robot.remove("sensor/new")
    await viewer.until(lambda: "/sensor/new" not in viewer.channels)
    gateway.robot.add(new)
    assert (await viewer.channel("/sensor/new"))["id"] == first["id"]


async def test_a_client_unsubscribes_and_uses_the_number_again(
    gateway: Site, viewer: Viewer
) -> None:
    await viewer.subscribe("/sensor/level", 1)
    await viewer.message(1)
    await viewer.send("unsubscribe", subscriptionIds=[1])
    await viewer.subscribe("/sensor/secret", 1)
    assert json.loads((await viewer.message(1))[1]) == "the hidden word"


async def test_a_number_in_use_and_a_second_subscription_are_told(
    gateway: Site, viewer: Viewer
) -> None:
    await viewer.subscribe("/sensor/level", 1)
    await viewer.subscribe("/sensor/secret", 1)
    assert "already in use" in (await viewer.op("status"))["message"]
    await viewer.subscribe("/sensor/level", 2)
    assert "already subscribed" in (await viewer.op("status"))["message"]


async def test_two_tabs_see_the_same(gateway: Site, viewer: Viewer) -> None:
    async with viewing(gateway.url, OPERATOR) as second:
        one = await viewer.subscribe("/sensor/level", 1)
        other = await second.subscribe("/sensor/level", 77)
        assert one["id"] == other["id"]
        await viewer.message(1)
        await second.message(77)
        for n in range(20):
            gateway.robot.measure("sensor/level", n + 0.5)
            await asyncio.sleep(0)
        await viewer.until(lambda: any(f[13:] == b"19.5" for f in viewer.frames))
        await second.until(lambda: any(f[13:] == b"19.5" for f in second.frames))
        assert [f[5:] for f in viewer.frames] == [f[5:] for f in second.frames]


async def test_a_tenant_is_named_by_the_url(gateway: Site) -> None:
    async with viewing(gateway.url, ADMIN) as viewer:
        await viewer.channel("/sensor/level")
    async with viewing(f"{gateway.url}/alpha", ADMIN) as viewer:
        await viewer.channel("/sensor/level")
    with pytest.raises(InvalidStatus) as refused:
        async with viewing(f"{gateway.url}/beta", OPERATOR):
            pass
    assert refused.value.response.status_code == 403


async def test_the_gateway_serves_at_the_root_of_a_port_of_its_own() -> None:
    async with site(own_port=0) as made:
        number = next(f["ports"]["foxglove"] for f in made.server.status.transports if "ports" in f)
        url = f"http://127.0.0.1:{number}"
        for path in ("", "/", "/alpha", "/foxglove"):
            async with viewing(url + path, OPERATOR) as viewer:
                await viewer.subscribe("/sensor/level")
                assert json.loads((await viewer.message())[1]) == 1.25


async def test_a_port_that_another_one_has_leaves_nothing_at_the_listener() -> None:
    async with site(own_port=0) as made:
        client_api = made.server.client_api
        with pytest.raises(PluginError):
            async with open_foxglove(FoxgloveConfig(path="/second", port=0), client_api):
                pass
        async with (
            open_foxglove(FoxgloveConfig(path="/second"), client_api),
            viewing(made.base + "/second", OPERATOR) as viewer,
        ):
            await viewer.channel("/sensor/level")


async def test_the_time_is_sent_where_it_is_configured() -> None:
    async with site(time=50.0) as made, viewing(made.url, OPERATOR) as viewer:
        assert "time" in (await viewer.op("serverInfo"))["capabilities"]
        frame = await viewer.frame(2)
        assert len(frame) == 9
        assert abs(struct.unpack_from("<Q", frame, 1)[0] / 1e9 - time.time()) < 600


async def test_what_is_not_shown_does_not_exist() -> None:
    async with site(show=["/sensor/level"]) as made, viewing(made.url, OPERATOR) as viewer:
        await viewer.channel("/sensor/level")
        assert set(viewer.channels) == {"/sensor/level"}
        assert set(viewer.services) <= {"/system/estop"}  # which can always be pressed


async def test_the_graph_shows_who_publishes_and_takes(gateway: Site, viewer: Viewer) -> None:
    await viewer.send("subscribeConnectionGraph")
    graph = await viewer.op("connectionGraphUpdate")
    assert {"name": "/sensor/level", "publisherIds": ["robot"]} in graph["publishedTopics"]
    assert {"name": "/cmd_vel", "subscriberIds": ["robot"]} in graph["subscribedTopics"]
    assert {"name": "/service/double", "providerIds": ["robot"]} in graph["advertisedServices"]
    await viewer.subscribe("/sensor/level")
    graph = await viewer.op("connectionGraphUpdate")
    assert [one["name"] for one in graph["subscribedTopics"]] == ["/sensor/level"]
    gateway.robot.remove("sensor/secret")
    graph = await viewer.op("connectionGraphUpdate")
    assert graph["removedTopics"] == ["/sensor/secret"]
    await viewer.send("unsubscribeConnectionGraph")
