"""What a viewer does: publishing is writing, calling is executing, and every rule holds."""

from __future__ import annotations

import asyncio
import json
import struct
from typing import Any

import msgspec
import pytest

from configuration import key, role, rule, table
from plugins.foxglove.rig import ADMIN, OPERATOR, WATCHER, Site, site
from plugins.foxglove.viewer import BOUND, Viewer, viewing
from rcp_foxglove.leases import Leases
from rcp_gateway.testing import SteppedClock, eventually
from rcp_kernel.model import Resource
from rcp_kernel.types import AngularVelocity, LinearVelocity, Twist, quantity

pytestmark = pytest.mark.anyio
AHEAD = {"linear": {"x": 0.5}}
LONG = 10.0  # s that a velocity is valid: longer than any machine takes to pass it on


async def advertised(viewer: Viewer, topic: str = "/cmd_vel", encoding: str = "json") -> None:
    channel = {"id": 3, "topic": topic, "encoding": encoding, "schemaName": "Twist"}
    await viewer.send("advertise", channels=[channel])


async def written(site: Site, count: int = 1) -> list[Any]:
    async def there() -> bool:
        return len(site.robot.writes) >= count

    await eventually(there, f"{count} values were written")
    return [value for _, value in site.robot.writes]


async def test_a_published_message_is_written(gateway: Site, viewer: Viewer) -> None:
    await advertised(viewer)
    await viewer.publish(3, AHEAD)
    assert (await written(gateway))[0] == Twist(LinearVelocity(0.5))
    assert gateway.robot.writes[0][0] == "actuator/cmd_vel"


async def test_a_path_is_a_topic_too(gateway: Site, viewer: Viewer) -> None:
    await advertised(viewer, "/actuator/arm/cmd_vel")
    await viewer.publish(3, {"angular": {"z": 1.0}})
    assert (await written(gateway))[0] == Twist(angular=AngularVelocity(z=1.0))


async def test_a_message_in_the_robots_own_bytes_is_decoded_and_checked(
    gateway: Site, viewer: Viewer
) -> None:
    await advertised(viewer, encoding="cdr")
    await viewer.publish(3, b"\x00\x01\x00\x00" + struct.pack("<d", 0.25))
    assert (await written(gateway))[0] == Twist(LinearVelocity(0.25))
    await viewer.publish(3, b"\x00")
    await viewer.until(lambda: "not a pkg/msg/Drive" in str(viewer.statuses))


async def test_without_further_messages_the_dead_man_stops_the_robot(
    stepped: SteppedClock,
) -> None:
    async with (
        site(valid_for=LONG, clock=stepped.clock) as made,
        viewing(made.url, OPERATOR) as viewer,
    ):
        await advertised(viewer)
        await viewer.publish(3, AHEAD)
        assert await written(made) == [Twist(LinearVelocity(0.5))]
        stepped.advance(2 * LONG)
        assert (await written(made, 2))[-1] == Twist()


async def test_an_invalid_message_is_told_and_a_valid_one_ends_the_problem(
    gateway: Site, viewer: Viewer
) -> None:
    await advertised(viewer)
    await viewer.publish(3, {"linear": {"x": "fast"}})
    await viewer.until(lambda: "publish:/cmd_vel" in viewer.statuses)
    assert viewer.statuses["publish:/cmd_vel"]["level"] == 2
    assert "/cmd_vel" in viewer.statuses["publish:/cmd_vel"]["message"]
    await viewer.publish(3, AHEAD)
    await viewer.until(lambda: not viewer.statuses)


async def test_nothing_is_published_on_a_topic_that_does_not_exist(
    gateway: Site, viewer: Viewer
) -> None:
    await advertised(viewer, "/nowhere")
    await viewer.until(lambda: "publish:/nowhere" in viewer.statuses)
    assert "/cmd_vel" in viewer.statuses["publish:/nowhere"]["message"]
    await viewer.publish(3, AHEAD)
    await viewer.send("unadvertise", channelIds=[3])
    await viewer.until(lambda: not viewer.statuses)
    assert not gateway.robot.writes


async def test_a_topic_that_appears_later_is_published_on(gateway: Site, viewer: Viewer) -> None:
    await advertised(viewer, "/late")
    await viewer.until(lambda: "publish:/late" in viewer.statuses)
    gateway.robot.add(
        Resource(
            name="actuator/late",
            description="Late.",
            value=Twist,
            safe=Twist(),
            meta={"topic": "/late"},
        )
    )
    await viewer.until(lambda: not viewer.statuses)
    await viewer.publish(3, AHEAD)
    assert await written(gateway)


async def test_who_may_only_watch_publishes_nothing(gateway: Site) -> None:
    async with viewing(gateway.url, WATCHER) as viewer:
        await advertised(viewer)
        await viewer.until(lambda: "publish:/cmd_vel" in viewer.statuses)
        await viewer.publish(3, AHEAD)
        await viewer.send("setParameters", parameters=[{"name": "/param/limit", "value": 2}])
        await viewer.op("status", level=2)
    assert not gateway.robot.writes


async def test_under_an_emergency_stop_nothing_moves(gateway: Site, viewer: Viewer) -> None:
    await advertised(viewer)
    await viewer.call("/system/estop", {"reason": "smoke"})
    _, _, payload = await viewer.response()
    assert json.loads(payload)["active"] is True
    await viewer.publish(3, AHEAD)
    await viewer.until(lambda: "publish:/cmd_vel" in viewer.statuses)
    assert "stop" in viewer.statuses["publish:/cmd_vel"]["message"]
    assert Twist(LinearVelocity(0.5)) not in [value for _, value in gateway.robot.writes]


LEASED = table("safety", lease_required=["/tenant/alpha/actuator/**"])


async def test_a_lease_is_acquired_where_one_is_required_and_released_at_the_end() -> None:
    async with (
        site(more=LEASED) as made,
        viewing(made.url, OPERATOR) as viewer,
        viewing(made.url + "/alpha", ADMIN) as second,
    ):
        await advertised(viewer)
        await viewer.publish(3, AHEAD)
        assert await written(made)
        await advertised(second)
        await second.publish(3, {"linear": {"x": 0.1}})
        await second.until(lambda: "publish:/cmd_vel" in second.statuses)
        assert "operator" in second.statuses["publish:/cmd_vel"]["message"]
        await viewer.send("unadvertise", channelIds=[3])

        async def taken() -> bool:
            await second.publish(3, {"linear": {"x": 0.1}})
            return Twist(LinearVelocity(0.1)) in [value for _, value in made.robot.writes]

        await eventually(taken, "the second viewer drives")


async def test_a_velocity_that_waited_for_its_lease_too_long_is_not_driven(
    monkeypatch: pytest.MonkeyPatch, stepped: SteppedClock
) -> None:
    """As that of a robot with a gateway of its own, which is asked over a slow link."""
    usual, asked = Leases.acquire, asyncio.Event()

    async def slow(self: Leases, path: str) -> Any:
        if not asked.is_set():
            stepped.advance(2 * LONG)
        asked.set()
        return await usual(self, path)

    monkeypatch.setattr(Leases, "acquire", slow)
    async with (
        site(more=LEASED, valid_for=LONG, clock=stepped.clock) as made,
        viewing(made.url, OPERATOR) as viewer,
    ):
        await advertised(viewer)
        await viewer.publish(3, AHEAD)
        async with asyncio.timeout(BOUND):
            await asked.wait()
        await viewer.publish(3, {"linear": {"x": 0.1}})
        assert await written(made)
        assert Twist(LinearVelocity(0.5)) not in [value for _, value in made.robot.writes]


async def test_a_lease_that_a_person_takes_is_not_taken_back() -> None:
    take = {"do": "acquire", "scope": "/tenant/alpha/actuator", "take": True, "reason": "mine"}
    text = LEASED + role(
        "boss", rule("discover read write execute", "/**", "/system/leases"), priority=90
    )
    boss = "boss-of-these-tests"
    async with (
        site(more=text + key("boss", boss)) as made,
        viewing(made.url, OPERATOR) as viewer,
    ):
        await advertised(viewer)
        await viewer.publish(3, AHEAD)
        await written(made)
        person = made.served.client(boss)
        held = await person.request("execute", "/system/leases", body=take)
        assert held["status"] == "completed", held
        assert "boss" in (await viewer.op("status", level=1))["message"]
        before = len(made.robot.writes)
        for _ in range(3):
            await viewer.publish(3, {"linear": {"x": 0.9}})
        await viewer.until(lambda: "publish:/cmd_vel" in viewer.statuses)
        release = {"do": "release", "lease": held["body"]["lease"]}
        done = await person.request("execute", "/system/leases", body=release)
        assert done["status"] == "completed"
        await viewer.publish(3, {"linear": {"x": 0.9}})
        await viewer.send("getParameters", parameterNames=["/param/limit"], id="after")
        await viewer.op("parameterValues", id="after")
        driven = [value for _, value in made.robot.writes[before:]]
        assert Twist(LinearVelocity(0.9)) not in driven
        await viewer.send("unadvertise", channelIds=[3])
        await advertised(viewer)

        async def driving() -> bool:
            await viewer.publish(3, {"linear": {"x": 0.9}})
            return Twist(LinearVelocity(0.9)) in [value for _, value in made.robot.writes]

        await eventually(driving, "the viewer drives again")


async def test_two_tabs_that_drive_are_the_two_commanders_of_any_protocol(gateway: Site) -> None:
    async with (
        viewing(gateway.url, OPERATOR) as one,
        viewing(gateway.url, OPERATOR) as other,
    ):
        for viewer in (one, other):
            await advertised(viewer)
        for n in range(10):
            await one.publish(3, {"linear": {"x": n / 10}})
            await other.publish(3, {"linear": {"x": -n / 10}})
        await written(gateway, 2)
        told = [*one.statuses.values(), *other.statuses.values()]
        assert not [status for status in told if status["level"] > 1]


async def test_of_velocities_a_slow_robot_gets_the_newest_one(
    gateway: Site, viewer: Viewer
) -> None:
    release = asyncio.Event()

    async def slow(value: Any) -> None:
        await release.wait()

    gateway.robot.takes["actuator/arm/cmd_vel"] = slow
    await advertised(viewer, "/actuator/arm/cmd_vel")
    for n in range(1, 101):
        await viewer.publish(3, {"linear": {"x": float(n)}})
    await viewer.send("getParameters", parameterNames=["/param/limit"], id="after")
    await viewer.op("parameterValues", id="after")
    release.set()
    assert (await written(gateway, 2))[1].linear.x == 100.0
    assert "98 messages were skipped" in (await viewer.op("status", level=1))["message"]


async def test_of_other_messages_a_slow_robot_gets_all_that_fit_into_the_bytes_of_a_client(
    gateway: Site, viewer: Viewer
) -> None:
    release = asyncio.Event()

    async def slow(value: Any) -> None:
        await release.wait()

    async def published(messages: list[str]) -> None:
        for text in messages:
            await viewer.publish(3, text)
        await viewer.send("getParameters", parameterNames=["/param/limit"], id=messages[-1][-9:])
        await viewer.op("parameterValues", id=messages[-1][-9:])

    robot = gateway.robot
    robot.takes["actuator/screen"] = slow
    await advertised(viewer, "/actuator/screen")
    dear = [f"{'x' * 1_000_000}{n:09}" for n in range(14)]  # fewer than may wait if they are short
    await published(dear)
    release.set()
    status = await viewer.op("status", level=1)

    async def last_one_shown() -> bool:
        return robot.writes[-1][1][-9:] == dear[-1][-9:]

    await eventually(last_one_shown, "the newest text is shown")
    shown = len(robot.writes)
    assert shown <= 6  # the first one, and those of 4 MiB
    assert f"{len(dear) - shown} messages were skipped" in status["message"]

    release.clear()
    robot.writes.clear()
    short = [f"{n:09}" for n in range(16)]
    await published(short)
    release.set()
    assert await written(gateway, len(short)) == short


async def test_a_velocity_that_waited_too_long_is_not_driven(stepped: SteppedClock) -> None:
    async with (
        site(valid_for=LONG, clock=stepped.clock) as made,
        viewing(made.url, OPERATOR) as viewer,
    ):
        release = asyncio.Event()

        async def slow(value: Any) -> None:
            await release.wait()

        made.robot.takes["actuator/cmd_vel"] = slow
        await advertised(viewer)
        await viewer.publish(3, AHEAD)
        await written(made)
        await viewer.publish(3, {"linear": {"x": 0.9}})
        await viewer.send("getParameters", parameterNames=["/param/limit"], id="after")
        await viewer.op("parameterValues", id="after")
        stepped.advance(2 * LONG)
        release.set()
        assert (await written(made, 2))[-1] == Twist()
        await viewer.publish(3, {"linear": {"x": 0.1}})
        assert Twist(LinearVelocity(0.9)) not in await written(made, 3)


async def test_of_goals_a_slow_robot_gets_all_in_order_up_to_a_number(
    gateway: Site, viewer: Viewer
) -> None:
    release = asyncio.Event()

    async def slow(value: Any) -> None:
        await release.wait()

    gateway.robot.takes["actuator/goal"] = slow
    gateway.robot.add(Resource(name="actuator/goal", description="Goes.", value=quantity("m")))
    await viewer.channel("/actuator/goal")
    await advertised(viewer, "/actuator/goal")
    for n in range(100):
        await viewer.publish(3, float(n))
    await viewer.send("getParameters", parameterNames=["/param/limit"], id="after")
    await viewer.op("parameterValues", id="after")
    release.set()

    async def last() -> bool:
        return ("actuator/goal", 99.0) in gateway.robot.writes

    await eventually(last, "the last of them was written")
    values = [value for _, value in gateway.robot.writes]
    assert values[-16:] == [float(n) for n in range(84, 100)]
    assert len(values) <= 17  # the first may have been on its way before the second came


async def test_a_service_is_called_with_json(gateway: Site, viewer: Viewer) -> None:
    await viewer.call("/service/double", 21, 5)
    assert await viewer.response() == (5, "json", b"42")


async def test_an_action_is_called_like_a_service(gateway: Site, viewer: Viewer) -> None:
    await viewer.call("/action/go", 2.5, 6)
    async with asyncio.timeout(BOUND):
        assert await gateway.robot.started.get() == 2.5
    gateway.robot.release.set()
    assert await viewer.response() == (6, "json", b"2.5")


async def test_a_call_that_fails_says_why(gateway: Site, viewer: Viewer) -> None:
    await viewer.call("/service/refuse", {}, 8)
    failure = await viewer.op("serviceCallFailure", callId=8)
    assert failure["serviceId"] == viewer.services["/service/refuse"]["id"]
    assert "the lid is open" in failure["message"]
    await viewer.call("/service/double", "one", 9)
    assert (await viewer.op("serviceCallFailure", callId=9))["message"]
    await viewer.call("/service/double", b"", 10, "cdr")
    assert "json" in (await viewer.op("serviceCallFailure", callId=10))["message"]
    await viewer.socket.send(struct.pack("<BIII", 2, 4_000_000, 11, 4) + b"json1")
    assert "does not exist" in (await viewer.op("serviceCallFailure", callId=11))["message"]


async def test_many_calls_run_at_once_and_too_many_are_refused(
    gateway: Site, viewer: Viewer
) -> None:
    gateway.robot.add(Resource(name="service/wait", description="Waits.", input=int, output=int))
    for n in range(300):
        await viewer.call("/service/wait", n, n)
    failure = await viewer.op("serviceCallFailure")
    assert "not answered yet" in failure["message"]
    gateway.robot.release.set()
    seen = {(await viewer.response())[0] for _ in range(200)}
    assert len(seen) == 200


async def test_a_stop_is_never_a_call_too_many(gateway: Site, viewer: Viewer) -> None:
    gateway.robot.add(Resource(name="service/wait", description="Waits.", input=int, output=int))
    for n in range(300):
        await viewer.call("/service/wait", n, n)
    await viewer.call("/system/estop", {}, 1000)
    assert (await viewer.response())[0] == 1000


async def test_parameters_are_read_written_and_followed(gateway: Site, viewer: Viewer) -> None:
    await viewer.send("getParameters", parameterNames=[], id="all")
    values = await viewer.op("parameterValues", id="all")
    assert {one["name"]: one["value"] for one in values["parameters"]} == {
        "/param/limit": 1.0,
        "/param/model": "rover",
    }
    assert next(p for p in values["parameters"] if p["name"] == "/param/limit")["type"] == "float64"
    await viewer.send("subscribeParameterUpdates", parameterNames=["/param/limit"])
    wish = [{"name": "/param/limit", "value": 2.0}, {"name": "/param/none", "value": 1}]
    await viewer.send("setParameters", parameters=wish, id="set")
    assert "/param/none" in (await viewer.op("status"))["message"]
    answer = await viewer.op("parameterValues", id="set")
    assert [one["value"] for one in answer["parameters"]] == [2.0]
    update = await viewer.op("parameterValues")
    assert update["parameters"] == [{"name": "/param/limit", "type": "float64", "value": 2.0}]
    gateway.robot.measure("param/limit", 0.5)
    assert (await viewer.op("parameterValues"))["parameters"][0]["value"] == 0.5
    await viewer.send("unsubscribeParameterUpdates", parameterNames=[])


async def test_a_parameter_out_of_range_is_refused_in_words(gateway: Site, viewer: Viewer) -> None:
    await viewer.send("setParameters", parameters=[{"name": "/param/limit", "value": 9}], id="x")
    assert "2.5" in (await viewer.op("status", level=2))["message"]
    answer = await viewer.op("parameterValues", id="x")
    assert answer["parameters"][0]["value"] == 1.0
    await viewer.send("setParameters", parameters=[{"name": "/param/limit"}])
    assert "removed" in (await viewer.op("status", level=2))["message"]
    await viewer.send("setParameters", parameters=[{"name": "/param/model", "value": "x"}])
    await viewer.op("status", level=2)


class Fetch(msgspec.Struct, frozen=True):
    """A file that is wanted."""

    uri: str


class File(msgspec.Struct, frozen=True):
    """A file."""

    media_type: str
    data: bytes


async def test_files_of_a_description_are_fetched(gateway: Site, viewer: Viewer) -> None:
    await viewer.send("fetchAsset", uri="package://rover/base.stl", requestId=1)
    frame = await viewer.frame(4)
    request, status, length = struct.unpack_from("<IBI", frame, 1)
    assert (request, status) == (1, 1)
    assert "no robot here" in frame[10 : 10 + length].decode()

    async def fetch(value: Fetch, _progress: Any) -> File:
        assert value.uri == "package://rover/base.stl"
        return File("model/stl", b"solid rover")

    gateway.robot.behaviours["service/assets/fetch"] = fetch
    gateway.robot.add(
        Resource(name="service/assets/fetch", description="Files.", input=Fetch, output=File)
    )
    await viewer.until(lambda: "/service/assets/fetch" in viewer.services)
    await viewer.send("fetchAsset", uri="package://rover/base.stl", requestId=2)
    assert await viewer.frame(4) == struct.pack("<BIBI", 4, 2, 0, 0) + b"solid rover"
