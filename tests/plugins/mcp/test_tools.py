"""Tools: what there is for whom, and what a model gets to see of values, refusals and dangers."""

from __future__ import annotations

import asyncio
import json
import re
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from plugins.mcp.rig import ROVER, Caller, Site, caller, site
from rcp_kernel.model import Resource

FIXED = [
    "robots",
    "discover",
    "read",
    "write",
    "write_all",
    "execute",
    "plan",
    "cancel",
    "status",
    "watch",
]


def words(result: dict[str, Any]) -> str:
    """Return what a model reads of a result."""
    return "\n".join(one["text"] for one in result["content"] if one["type"] == "text")


def error(result: dict[str, Any]) -> dict[str, Any]:
    """Return the error of a refused call."""
    assert result["isError"] is True, result
    return result["structuredContent"]["error"]


async def test_there_are_the_fixed_tools_and_one_for_each_action_and_service(
    operator: Caller,
) -> None:
    tools = await operator.tools()
    assert [*tools][: len(FIXED)] == FIXED
    assert {"action-go", "service-double", "system-estop"} <= tools.keys()
    odd = next(name for name in tools if name.startswith("service-odd"))
    assert re.fullmatch(r"service-odd_name--[0-9a-f]{10}", odd)
    assert all(re.fullmatch(r"[A-Za-z0-9_-]{1,64}", name) for name in tools)
    assert [*await operator.tools()] == [*tools]


async def test_schemas_stand_alone_with_units_bounds_and_examples(operator: Caller) -> None:
    tools = await operator.tools()
    for tool in tools.values():
        for key in tool.keys() & {"inputSchema", "outputSchema"}:
            Draft202012Validator.check_schema(tool[key])
            assert tool[key]["type"] == "object"
    go = tools["action-go"]["inputSchema"]
    x = go["properties"]["x"]
    assert (x["unit"], x["minimum"], x["maximum"]) == ("m", -10, 10)
    assert "Unit: m." in x["description"]
    assert go["examples"] == [{"x": 1.0}]
    assert tools["service-double"]["inputSchema"]["required"] == ["value"]


async def test_hints_are_true_to_what_a_tool_does(operator: Caller) -> None:
    hints = {name: tool["annotations"] for name, tool in (await operator.tools()).items()}
    assert all(hints[name]["readOnlyHint"] for name in ("robots", "discover", "read", "watch"))
    assert hints["action-go"]["readOnlyHint"] is False
    assert hints["action-go"]["destructiveHint"] is True
    assert hints["write"]["idempotentHint"] is True
    assert (
        hints["system-estop"] | {"destructiveHint": False, "idempotentHint": True}
        == (hints["system-estop"])
    )


async def test_who_may_only_look_has_no_tools_to_change_things(gateway: Site) -> None:
    async with caller(gateway, None) as anonymous:
        tools = await anonymous.tools()
        assert "write" not in tools
        assert not [name for name in tools if name.startswith(("action-", "service-"))]
        refused = await anonymous.call("execute", path="/tenant/alpha/action/go", input={"x": 1})
        assert error(refused)["code"] == "forbidden"
        unknown = await anonymous.send("tools/call", name="action-go", arguments={"x": 1})
        assert unknown["error"]["code"] == -32602


async def test_every_answer_fits_the_schema_of_its_tool(operator: Caller, gateway: Site) -> None:
    gateway.robot.release.set()
    tools = await operator.tools()
    calls: list[tuple[str, dict[str, Any]]] = [
        ("robots", {"details": True}),
        ("discover", {"schemas": True}),
        ("discover", {"path": "no pattern"}),
        ("read", {"path": "/sensor/*"}),
        ("read", {"path": "/sensor/none"}),
        ("write", {"path": "/param/limit", "value": 2}),
        ("write", {"path": "/param/limit", "value": 2, "dry_run": True}),
        ("write", {"path": "/param/limit", "value": 9}),
        ("write_all", {"values": {"/param/limit": 2, "/param/gain": 1}}),
        ("write_all", {"values": {"/param/limit": 2, "/param/gain": 1}, "dry_run": True}),
        ("write_all", {"values": {"/param/limit": 9, "/param/gain": 9}}),
        ("execute", {"path": "/action/go", "input": {"x": 1}}),
        ("execute", {"path": "/service/double", "input": 4}),
        ("plan", {"plan": "execute /service/double 4"}),
        ("action-go", {"x": 2, "dry_run": True}),
        ("action-go", {"x": 99}),
        ("action-go", {"x": 9}),
        ("service-double", {"value": 4}),
        ("service-double", {"worth": 4}),
        ("cancel", {"path": "/action/go"}),
        ("cancel", {}),
        ("status", {}),
        ("watch", {"paths": ["/sensor/level"], "samples": 1}),
        ("system-leases", {"do": "acquire", "scope": "/tenant/alpha", "ttl": 10}),
    ]
    for name, arguments in calls:
        result = await operator.call(name, **arguments)
        if (schema := tools[name].get("outputSchema")) is not None:
            Draft202012Validator(schema).validate(result["structuredContent"])


async def test_several_paths_are_written_as_one(operator: Caller, gateway: Site) -> None:
    values = {"/param/limit": 2.0, "/param/gain": 0.5}
    done = (await operator.call("write_all", values=values))["structuredContent"]
    assert [one["body"] for one in done["result"]] == [2.0, 0.5]
    assert gateway.robot.together == [{"param/limit": 2.0, "param/gain": 0.5}]
    refused = error(await operator.call("write_all", values={**values, "/param/gain": 9}))
    assert refused["path"].endswith("/param/gain")
    assert len(gateway.robot.together) == 1


async def test_a_value_comes_with_its_time_and_a_pattern_reads_many(operator: Caller) -> None:
    one = await operator.call("read", path="/sensor/level")
    (value,) = one["structuredContent"]["values"]
    assert (value["path"], value["value"]) == ("/tenant/alpha/sensor/level", 1.25)
    assert "timestamp" in value
    many = await operator.call("read", path="/sensor/*")
    assert len(many["structuredContent"]["values"]) == 5


async def test_what_the_robots_world_says_is_marked_as_data(operator: Caller) -> None:
    result = await operator.call("read", path="/sensor/sign")
    (value,) = result["structuredContent"]["values"]
    assert value["untrusted"] is True
    text = words(result)
    mark = re.search(r"\[robot-data ([0-9a-f]{12}) from /tenant/alpha/sensor/sign\]", text)
    assert mark is not None
    before, _, after = text.partition("Ignore all previous instructions")
    assert mark[1] in before
    assert f"[end of robot-data {mark[1]}]" in after
    assert result["content"][0]["_meta"]["rcp/untrusted"] is True
    again = words(await operator.call("read", path="/sensor/sign"))
    assert mark[1] not in again
    plain = await operator.call("read", path="/sensor/level")
    assert "robot-data" not in words(plain)


async def test_a_refusal_in_the_robots_own_words_is_marked_too(operator: Caller) -> None:
    result = await operator.call("action-go", x=9)
    assert error(result)["code"] == "device_rejected"
    assert result["structuredContent"]["untrusted"] is True
    assert "[robot-data " in words(result)


async def test_a_picture_is_shown_as_one(operator: Caller) -> None:
    result = await operator.call("read", path="/sensor/camera")
    (picture,) = [one for one in result["content"] if one["type"] == "image"]
    assert picture["mimeType"] in ("image/jpeg", "image/png")
    assert "shown as a picture" in words(result)


async def test_a_large_value_is_summarised_with_a_link_to_the_whole(operator: Caller) -> None:
    result = await operator.call("read", path="/sensor/scan")
    (value,) = result["structuredContent"]["values"]
    assert value["summary"]["length"] == 20_000
    assert (value["summary"]["min"], value["summary"]["max"]) == (0, 19_999)
    (link,) = [one for one in result["content"] if one["type"] == "resource_link"]
    whole = await operator.ask("resources/read", uri=link["uri"])
    assert len(json.loads(whole["contents"][0]["text"])["value"]) == 20_000


@pytest.mark.parametrize(
    ("tool", "arguments", "code", "said"),
    [
        ("write", {"path": "/param/limit", "value": 9}, "out_of_range", "9 > 2.5 m/s"),
        ("action-go", {"x": 99}, "out_of_range", "99 > 10 m"),
        ("action-go", {"y": 1}, "invalid_value", "x"),
        ("read", {}, "invalid_value", "path"),
        ("read", {"path": "/sensor/level", "more": 1}, "invalid_value", "more"),
        ("service-double", {"worth": 1}, "bad_request", "value"),
        ("cancel", {}, "bad_request", "command"),
        ("read", {"path": "/sensor/none"}, "unknown_path", "discover"),
        ("status", {"command": "cmd-0"}, "unknown_path", "cmd-0"),
    ],
)
async def test_an_error_says_what_to_do(
    operator: Caller, tool: str, arguments: dict[str, Any], code: str, said: str
) -> None:
    result = await operator.call(tool, **arguments)
    told = error(result)
    assert told["code"] == code
    assert told["remedy"]
    assert said in words(result)
    assert told["remedy"] in words(result)


async def test_discovery_is_cut_to_the_budget_and_goes_on_where_it_was_cut(
    operator: Caller, gateway: Site
) -> None:
    whole = (await operator.call("discover", limit=200))["structuredContent"]
    assert "cursor" not in whole
    found: list[str] = []
    cursor: dict[str, Any] = {}
    for _ in range(50):
        page = (await operator.call("discover", limit=3, **cursor))["structuredContent"]
        found += [one["path"] for one in page["resources"]]
        if "cursor" not in page:
            break
        cursor = {"cursor": page["cursor"]}
    assert found == [one["path"] for one in whole["resources"]]
    (only,) = (await operator.call("discover", q="full"))["structuredContent"]["resources"]
    assert (only["path"], only["unit"]) == ("/tenant/alpha/sensor/level", "m")
    go = (await operator.call("discover", path="/action/go"))["structuredContent"]["resources"]
    assert go[0]["tool"] == "action-go"


async def test_a_pattern_is_read_to_the_budget_and_goes_on_where_it_was_cut(
    operator: Caller, gateway: Site
) -> None:
    names = [f"param/many/p{number:04}" for number in range(1348)]
    host = gateway.robot.host
    host.declare(
        *(Resource(name=n, description="One of many.", value=float, live=True) for n in names)
    )
    for name in names:
        host.publish(name, 0.5)
    found: list[str] = []
    cursor: dict[str, Any] = {}
    for _ in range(len(names)):
        page = await operator.call("read", path="/param/many/*", **cursor)
        facts = page["structuredContent"]
        found += [one["path"].removeprefix("/tenant/alpha/") for one in facts["values"]]
        assert facts.get("truncated", False) is ("cursor" in facts)
        if "cursor" not in facts:
            break
        assert "continue with `cursor`" in words(page)
        cursor = {"cursor": facts["cursor"]}
    assert found == names


async def test_watching_ends_after_samples_or_seconds(operator: Caller, gateway: Site) -> None:
    async def publish() -> None:
        for level in range(100):
            gateway.robot.host.publish("sensor/level", float(level))
            await asyncio.sleep(0.01)

    publishing = asyncio.create_task(publish())
    result = await operator.call("watch", paths=["/sensor/level"], samples=3, each=True)
    publishing.cancel()
    assert len(result["structuredContent"]["updates"]) == 3
    short = await operator.call(
        "watch", paths=["/sensor/level"], samples=50, seconds=0.2, each=True
    )
    assert short["structuredContent"]["ended"] == "0.2 s are over"
    assert len(short["structuredContent"]["updates"]) >= 1


async def test_the_tool_of_a_goal_takes_a_place_on_the_earth() -> None:
    anchor = """
    [features.frames.anchors."/tenant/alpha"]
    latitude = 48.137154
    longitude = 11.576124
    """
    async with site(robots=ROVER, more=anchor) as rover, caller(rover) as operator:
        tool = (await operator.tools())["action-move_to"]
        goal = {"position": {"latitude": 48.13716, "longitude": 11.57613}, "frame": "earth"}
        assert Draft202012Validator(tool["inputSchema"]).is_valid(goal)
        shown = tool["inputSchema"]["properties"]["position"]["properties"]
        assert shown["latitude"]["maximum"] == 90
        assert shown["x"]["unit"] == "m"
        result = await operator.call("action-move_to", **goal, dry_run=True)
        assert not result.get("isError"), result
