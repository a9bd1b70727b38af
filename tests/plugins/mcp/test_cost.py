"""What a model has to read before it can act is bounded, and what it costs can be looked up."""

from __future__ import annotations

import asyncio
import json
import sys
from pathlib import Path
from typing import Any

import pytest

from configuration import backend
from plugins.mcp.rig import BOUND, OPERATOR, Caller, Site, caller, site

pytestmark = pytest.mark.anyio
FLEET = "".join(backend(f"r{number}", use="sim", robot=f"r{number}") for number in range(4))
COMPACT = [
    "robots", "discover", "read", "write", "write_all", "execute", "plan", "cancel", "status",
    "watch", "system-estop",
]  # fmt: skip
BUDGET = 3000  # tokens of the default list
PAGE = 6000  # tokens of a page


def tokens(listed: Any) -> float:
    """Estimate the tokens of a list as `rcpctl mcp tools --cost` does."""
    return len(json.dumps(listed, ensure_ascii=False, separators=(",", ":")).encode()) / 4


async def pages(by: Caller) -> list[list[dict[str, Any]]]:
    found: list[list[dict[str, Any]]] = []
    cursor: dict[str, Any] = {}
    while not found or cursor:
        page = await by.ask("tools/list", **cursor)
        found.append(page["tools"])
        cursor = {"cursor": page["nextCursor"]} if page.get("nextCursor") else {}
    return found


@pytest.mark.parametrize("robots", [FLEET, backend("one", use="sim")], ids=["four", "one"])
async def test_the_default_list_is_short_for_any_number_of_robots(robots: str) -> None:
    async with site(robots=robots, mcp="") as made, caller(made) as operator:
        (tools,) = await pages(operator)
    assert [one["name"] for one in tools] == COMPACT
    assert tokens(tools) <= BUDGET
    assert {one["name"] for one in tools if "outputSchema" in one} <= {"system-estop"}


async def test_tools_that_are_not_listed_can_be_called_and_described() -> None:
    async with site(mcp="") as made, caller(made) as operator:
        made.robot.release.set()
        found = await operator.call("discover", path="/action/go", schemas=True)
        (one,) = found["structuredContent"]["resources"]
        assert one["schemas"]["input"]
        assert "tool" not in one
        done = await operator.call("execute", path="/action/go", input={"x": 1})
        assert done["structuredContent"]["status"] == "completed"
        named = await operator.call("action-go", x=1)
        assert named["structuredContent"]["status"] == "completed"


async def test_tools_of_every_path_come_in_pages() -> None:
    async with site(robots=FLEET, mcp='tools = ["/**"]') as made, caller(made) as operator:
        found = await pages(operator)
    names = [one["name"] for page in found for one in page]
    assert len(names) == len({*names}) > 40
    assert len(found) > 1
    assert all(tokens(page) <= PAGE for page in found)


async def test_tools_of_a_profile_are_chosen_by_its_name() -> None:
    async with site(robots=FLEET, mcp='profiles = ["mobile"]') as made, caller(made) as operator:
        names = {one["name"] for page in await pages(operator) for one in page}
    assert {"action-r0-move_to", "action-r3-move_to"} <= names
    assert "service-r0-inject_fault" not in names


async def test_an_explicit_choice_of_paths_is_kept() -> None:
    async with site(mcp='tools = ["/action/**"]') as made, caller(made) as operator:
        tools = await operator.tools()
        assert "action-go" in tools
        assert "service-double" not in tools
        unknown = await operator.send("tools/call", name="service-double", arguments={"value": 1})
        assert unknown["error"]["code"] == -32602


async def test_a_status_waits_for_the_end_of_a_command(operator: Caller, gateway: Site) -> None:
    begun = await operator.call("execute", path="/action/go", input={"x": 1}, wait=0)
    command = begun["structuredContent"]["command"]
    early = await operator.call("status", command=command, wait=0.01)
    assert early["structuredContent"]["command"]["status"] == "in_progress"
    waiting = asyncio.ensure_future(operator.call("status", command=command, wait=BOUND))
    gateway.robot.release.set()
    done = (await waiting)["structuredContent"]["command"]
    assert done["status"] == "completed"


async def test_rcpctl_states_the_cost(gateway: Site) -> None:
    process = await asyncio.create_subprocess_exec(
        Path(sys.executable).with_name("rcpctl"), "mcp", "tools", "--cost", "--text",
        "--url", gateway.base, "--token", OPERATOR,
        stdout=asyncio.subprocess.PIPE,
    )  # fmt: skip
    async with asyncio.timeout(BOUND):
        output, _ = await process.communicate()
    assert process.returncode == 0
    lines = output.decode().splitlines()
    async with caller(gateway) as operator:
        (tools,) = await pages(operator)
    costs = {one["name"]: -(-int(4 * tokens(one)) // 4) for one in tools}
    assert lines[-1] == f"About {sum(costs.values())} tokens in 1 page(s)."
    assert lines[1].split() == [name := max(costs, key=lambda one: costs[one]), str(costs[name])]
