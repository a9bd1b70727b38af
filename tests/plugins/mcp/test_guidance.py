"""A model that errs is told what it may have meant, and only of what it may see."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from typing import Any

import pytest

from configuration import backend, key, role, rule, table
from plugins.mcp.rig import OPERATOR, Caller, Site, caller, site
from rcp_mcp.guidance import nearest

pytestmark = pytest.mark.anyio
NARROW = "narrow-narrow-narrow"
FLEET = "".join(backend(name, use="sim", robot=name) for name in ("r1", "r2"))
MORE = role("narrow", rule("discover read", "/tenant/*/sensor/r1/pose", "/system/robots")) + key(
    "narrow", NARROW, tenants=["alpha"]
)


@pytest.fixture
async def fleet() -> AsyncGenerator[Site]:
    async with site(robots=FLEET, mcp="", more=MORE) as made:
        yield made


@pytest.fixture
async def operator(fleet: Site) -> AsyncGenerator[Caller]:
    async with caller(fleet, OPERATOR) as made:
        yield made


async def hints(by: Caller, tool: str, /, **arguments: Any) -> list[str]:
    result = await by.call(tool, **arguments)
    assert result["isError"], result
    found: list[str] = result["structuredContent"]["error"].get("nearest", [])
    assert all(path in result["content"][-1]["text"] for path in found)
    return found


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        ("/sensor/r1/poze", "/tenant/alpha/sensor/r1/pose"),
        ("/sensor/pose", "/tenant/alpha/sensor/r1/pose"),
        ("/tenant/alpha/r2/sensor/pose", "/tenant/alpha/sensor/r2/pose"),
        ("r2/battery", "/tenant/alpha/sensor/r2/battery"),
    ],
)
async def test_a_wrong_path_is_answered_with_the_nearest(
    operator: Caller, wrong: str, right: str
) -> None:
    assert right in await hints(operator, "read", path=wrong)


async def test_a_command_to_a_wrong_path_too(operator: Caller) -> None:
    found = await hints(operator, "execute", path="/action/r1/moveto", input={})
    assert found[0] == "/tenant/alpha/action/r1/move_to"
    assert await hints(operator, "watch", paths=["/sensor/r1/batery"])


async def test_only_what_the_caller_sees_is_named(fleet: Site) -> None:
    async with caller(fleet, NARROW) as narrow:
        found = await hints(narrow, "read", path="/sensor/r2/pose")
        assert found == ["/tenant/alpha/sensor/r1/pose"]


def test_what_is_like_nothing_has_no_neighbours() -> None:
    assert nearest("/qqq/zzz", ["/tenant/alpha/sensor/pose"]) == []
    assert nearest("", []) == []
    many = [f"/tenant/alpha/sensor/r{number}/pose" for number in range(10_000)]
    assert nearest("/sensor/r7777/pose", many)[0] == "/tenant/alpha/sensor/r7777/pose"


async def test_an_address_is_accepted_wherever_a_path_is(operator: Caller) -> None:
    calls: list[tuple[str, dict[str, Any]]] = [
        ("read", {"path": "rcp://alpha/sensor/r1/pose"}),
        ("read", {"path": "rcp://alpha/sensor/*/pose"}),
        ("read", {"path": "rcp:///system/status"}),
        ("discover", {"path": "rcp://alpha/sensor/r1/*"}),
        ("watch", {"paths": ["rcp://alpha/sensor/r1/pose"], "samples": 1}),
        ("write", {"path": "rcp://alpha/param/r1/speed_limit", "value": 0.5}),
        ("execute", {"path": "rcp://alpha/service/r1/hold"}),
        ("system-estop", {"scope": "rcp://alpha/r1"}),
    ]
    for tool, arguments in calls:
        result = await operator.call(tool, **arguments)
        assert not result.get("isError"), (tool, result)


async def test_a_prompts_robot_is_completed_with_robots(operator: Caller, fleet: Site) -> None:
    async def complete(by: Caller, value: str) -> list[str]:
        ref = {"type": "ref/prompt", "name": "inspect"}
        argument = {"name": "robot", "value": value}
        result = await by.ask("completion/complete", ref=ref, argument=argument)
        return result["completion"]["values"]

    assert await complete(operator, "") == ["r1", "r2"]
    assert await complete(operator, "r2") == ["r2"]
    async with caller(fleet, NARROW) as narrow:
        assert await complete(narrow, "") == ["r1"]
    async with site(robots=backend("one", use="sim"), mcp="") as single, caller(single) as by:
        assert await complete(by, "") == ["/tenant/alpha"]


async def test_a_prompt_knows_the_places() -> None:
    given = table("features.places.given.dock", position={"latitude": 1.0, "longitude": 2.0})
    async with site(more=given) as made, caller(made) as by:
        ref = {"type": "ref/prompt", "name": "go_to"}
        argument = {"name": "destination", "value": "d"}
        found = await by.ask("completion/complete", ref=ref, argument=argument)
        assert found["completion"]["values"] == ["dock"]
        prompt = await by.ask("prompts/get", name="go_to", arguments={"destination": "dock"})
        text = prompt["messages"][0]["content"]["text"]
        assert "Go to dock." in text
        assert '{"position": {"place": "NAME"}}' in text
    async with site(more="[features]\nplaces = false\n") as made, caller(made) as by:
        found = await by.ask("completion/complete", ref=ref, argument=argument)
        assert found["completion"]["values"] == []


async def test_robots_come_first(operator: Caller) -> None:
    assert next(iter(await operator.tools())) == "robots"
