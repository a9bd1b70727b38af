"""What clients send that they should not: each is told why, and goes on."""

from __future__ import annotations

import json
from collections.abc import AsyncGenerator
from contextlib import suppress

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from plugins.rosbridge.rig import OPEN, ROVER, Page, Site, page, site
from rcp_kernel.errors import BadRequest
from rcp_rosbridge.operations import decode


@pytest.fixture
async def gateway() -> AsyncGenerator[Site]:
    async with site(OPEN, ROVER) as made:
        yield made


@pytest.fixture
async def client(gateway: Site) -> AsyncGenerator[Page]:
    async with page(gateway) as made:
        yield made


BAD = [
    ("garbage", "not an operation"),
    ("[]", "not an operation"),
    ("null", "not an operation"),
    ('{"id": "1"}', "malformed operation"),
    ('{"op": 3}', "not an operation"),
    ('{"op": "fly"}', "unknown operation 'fly'"),
    ('{"op": "publish"}', "malformed publish"),
    ('{"op": "publish", "topic": ""}', "malformed publish"),
    ('{"op": "publish", "topic": 5, "msg": {}}', "malformed publish"),
    ('{"op": "publish", "topic": "/cmd_vel", "msg": "hello"}', "/cmd_vel"),
    ('{"op": "publish", "topic": "/cmd_vel", "msg": [1, 2]}', "/cmd_vel"),
    ('{"op": "publish", "topic": "/cmd_vel", "msg": {"linear": {"x": "fast"}}}', "/cmd_vel"),
    ('{"op": "publish", "topic": "/odom", "msg": {}}', "takes no messages"),
    (
        '{"op": "publish", "topic": "/cmd_vel", "msg": {"secs": 1, "nsecs": 2, "x": '
        + "[" * 900
        + "]" * 900
        + "}}",
        "nested too deep",
    ),
    ('{"op": "publish", "topic": "/goal_pose", "msg": 3}', "/goal_pose"),
    ('{"op": "subscribe", "topic": "/odom", "compression": "zip"}', "malformed subscribe"),
    ('{"op": "subscribe", "topic": "/odom", "throttle_rate": -1}', "malformed subscribe"),
    ('{"op": "subscribe", "topic": "/odom", "queue_length": "x"}', "malformed subscribe"),
    ('{"op": "unsubscribe", "topic": "/nothing"}', "no subscription"),
    ('{"op": "unadvertise", "topic": "/nothing"}', "was not advertised"),
    ('{"op": "advertise", "topic": "/cmd_vel", "type": "std_msgs/String"}', "has the type"),
    ('{"op": "cancel_action_goal", "action": "/x", "id": "1"}', "has no goal"),
    ('{"op": "set_level", "level": "loud"}', "malformed set_level"),
    ('{"op": "fragment", "id": "f", "data": "x", "num": 5, "total": 2}', "fragment 5"),
    ('{"op": "fragment", "id": "f", "data": "x", "num": 0.5, "total": 2}', "whole numbers"),
    ('{"op": "fragment", "data": "x", "num": 0, "total": 2}', "needs an id"),
    ('{"op": "fragment", "id": "f", "data": "x", "num": 0, "total": 1e9}', "at most"),
    ('{"op": "auth"}', "no token"),
    ('{"op": "auth", "token": "nonsense"}', "authentication failed"),
    ('{"op": "png"}', "malformed png"),
    ('{"op": "png", "data": "x"}', "the picture cannot be read"),
    ('{"op": "png", "data": "iVBORw0KGgo="}', "the picture cannot be read"),
    ('{"op": "service_response", "service": "/x", "id": "1"}', "waits for an answer"),
    ('{"op": "service_response", "service": "/x", "id": {"a": 1}}', "not an operation"),
    ('{"op": "action_feedback", "action": "/x"}', "waits for an answer"),
    ('{"op": "action_result", "action": "/x", "id": 3, "status": "done"}', "malformed action"),
    ('{"op": "action_result", "action": "/x", "id": 3}', "waits for an answer"),
    ('{"op": "unadvertise_action", "action": "/x"}', "was not advertised"),
    ('{"op": "advertise_service", "service": "/x", "type": 5}', "malformed advertise_service"),
]


async def test_subscriptions_are_bounded_however_few_topics_they_are_to(client: Page) -> None:
    for number in range(4097):
        topic = f"/nothing{number % 5}"
        await client.send(op="subscribe", topic=topic, id=f"{number}")
    assert (await client.status("at most"))["id"] == "4096"
    await client.send(op="unsubscribe", topic="/nothing0", id="0")
    await client.send(op="subscribe", topic="/odom", id="room")
    await client.message("/odom")


async def test_advertisements_are_bounded_however_few_topics_they_are_of(client: Page) -> None:
    for number in range(4097):
        await client.send(op="advertise", topic="/cmd_vel", id=f"{number}")
    assert (await client.status("at most"))["id"] == "4096"
    await client.send(op="advertise", topic="/cmd_vel", id="1")  # again, which takes no room
    await client.send(op="unadvertise", topic="/cmd_vel", id="0")
    await client.send(op="advertise", topic="/cmd_vel", id="room")
    await client.send(op="advertise", topic="/odom", id="none")
    assert (await client.status("at most"))["id"] == "none"
    await client.send(op="unadvertise", topic="/cmd_vel")
    await client.send(op="advertise", topic="/odom", id="odom")
    assert (await client.status("published by the robot"))["id"] == "odom"


@pytest.mark.parametrize(("sent", "told"), BAD)
async def test_a_bad_operation_is_told_and_the_next_one_works(
    client: Page, sent: str, told: str
) -> None:
    await client.socket.send(sent)
    assert (await client.status(told))["level"] in ("error", "warning")
    assert "/odom" in (await client.values("/rosapi/topics"))["topics"]


async def test_a_call_with_bad_arguments_has_a_response(client: Page) -> None:
    for args in ('"x"', "3", "[1, 2, 3, 4, 5, 6]", '{"nix": 1}'):
        await client.socket.send(
            f'{{"op": "call_service", "id": "c", "service": "/place_obstacle", "args": {args}}}'
        )
        response = await client.op("service_response", id="c")
        assert response["result"] is False
        assert isinstance(response["values"], str)
    for args in ('"x"', '{"type": 3}'):
        await client.socket.send(
            f'{{"op": "call_service", "id": "d", "service": "/rosapi/topics_for_type", "args": {args}}}'
        )
        assert (await client.op("service_response", id="d"))["result"] is False


async def test_fragments_in_any_order_make_a_message(client: Page) -> None:
    text = json.dumps({"op": "call_service", "id": "f", "service": "/rosapi/get_time"})
    parts = [text[at : at + 10] for at in range(0, len(text), 10)]
    for num in reversed(range(len(parts))):
        await client.send(op="fragment", id="x", data=parts[num], num=num, total=len(parts))
    assert (await client.op("service_response", id="f"))["result"]


async def test_fragments_without_text_are_not_gathered_without_end(
    client: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcp_rosbridge.fragments._PARTS", 4)
    for id_ in "xyz":
        for num in range(2):
            await client.send(op="fragment", id=id_, data="", num=num, total=3)
    await client.status("have 4 fragments already")


async def test_fragments_that_contradict_each_other_are_told(client: Page) -> None:
    await client.send(op="fragment", id="x", data="a", num=0, total=3)
    await client.send(op="fragment", id="x", data="a", num=0, total=3)
    await client.status("came twice")
    await client.send(op="fragment", id="y", data="a", num=0, total=3)
    await client.send(op="fragment", id="y", data="a", num=1, total=4)
    await client.status("had 3 fragments")


async def test_fragments_that_do_not_come_are_told() -> None:
    async with site(OPEN, ROVER, fragment_timeout=0.3) as made, page(made) as client:
        await client.send(op="fragment", id="z", data="{}", num=0, total=2)
        assert (await client.status("1 are missing"))["id"] == "z"


async def test_incomplete_messages_are_bounded(client: Page) -> None:
    for number in range(40):
        await client.send(op="fragment", id=f"x{number}", data="a", num=0, total=2)
    await client.status("already incomplete")
    await client.values("/rosapi/get_time")


async def test_a_fragment_of_a_fragment_is_a_fragment(client: Page) -> None:
    inner = json.dumps({"op": "set_level", "level": "info"})
    outer = json.dumps({"op": "fragment", "id": "b", "data": inner, "num": 0, "total": 1})
    await client.send(op="fragment", id="a", data=outer, num=0, total=1)
    await client.values("/rosapi/get_time")


async def test_a_message_of_ten_megabytes_is_told_and_the_connection_stays(client: Page) -> None:
    text = '{"op": "publish", "topic": "/cmd_vel", "msg": {"x": "' + "a" * 5_000_000 + '"}}'
    await client.socket.send(text)
    await client.status("/cmd_vel")
    await client.socket.send([text[:5_000_000], *["a" * 5_000_000] * 3])
    await client.status("longer than")
    await client.socket.send("a" * 17_000_000)
    await client.status("longer than")
    await client.values("/rosapi/get_time")


async def test_a_long_message_keeps_its_place(client: Page) -> None:
    long = {"linear": {"x": 0.1}, "x": ["a" * 100] * 2000}
    await client.send(op="publish", topic="/cmd_vel", msg=long)
    assert (await client.call("/rosapi/get_time"))["result"]
    await client.status("/cmd_vel")


async def test_many_values_in_a_long_message_are_refused(client: Page) -> None:
    await client.socket.send('{"op": "publish", "topic": "/cmd_vel", "msg": ' + "[" * 400_000)
    await client.status("")
    await client.values("/rosapi/get_time")


async def test_a_flood_is_told_and_not_answered_one_by_one(client: Page) -> None:
    for _ in range(3000):
        await client.socket.send('{"op": "fly"}')
    await client.values("/rosapi/get_time")
    told = [m for m in client._received if m["op"] == "status"]  # noqa: SLF001
    assert 1 <= len(told) < 200


async def test_a_flood_of_velocities_keeps_the_newest(client: Page) -> None:
    await client.send(op="subscribe", topic="/velocity")
    for number in range(2000):
        speed = 0.0 if number < 1999 else 0.4
        await client.send(op="publish", topic="/cmd_vel", msg={"linear": {"x": speed}})
    await client.until(lambda m: m["op"] == "publish" and m["msg"]["twist"]["linear"]["x"] > 0.2)


async def test_subscriptions_and_topics_are_bounded(client: Page) -> None:
    for number in range(1100):
        await client.send(op="subscribe", topic=f"/nix{number}")
        await client.send(op="advertise", topic=f"/nix{number}", type="std_msgs/String")
    await client.status("at most 1000 topics")
    await client.status("advertises at most")
    await client.values("/rosapi/get_time")


async def test_levels_are_obeyed(client: Page) -> None:
    await client.send(op="set_level", level="none")
    await client.send(op="fly")
    await client.send(op="publish", topic="/nix", msg={})
    await client.values("/rosapi/get_time")
    assert not client._received  # noqa: SLF001 - what the client has kept
    await client.send(op="set_level", level="error")
    await client.send(op="fly")
    await client.status("unknown operation")


_json = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3)
    ),
    max_leaves=8,
)
_fields = st.sampled_from(
    (
        "op",
        "id",
        "topic",
        "type",
        "msg",
        "service",
        "args",
        "num",
        "total",
        "data",
        "level",
        "action",
    )
)
_ops = st.sampled_from(("publish", "subscribe", "call_service", "fragment", "auth", "fly"))


@given(st.dictionaries(_fields, _json, max_size=6), _ops)
@settings(suppress_health_check=list(HealthCheck), max_examples=300, deadline=None)
def test_whatever_is_sent_is_decoded_or_refused(fields: dict[str, object], op: str) -> None:
    data = msgspec.json.encode({"op": op, **fields})
    with suppress(BadRequest):
        decode(data)
