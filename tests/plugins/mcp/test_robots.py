"""The tool `robots`: the robots that a caller may see, found by the words people use."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from typing import Any

import pytest

from configuration import backend, key, role, rule
from plugins.mcp.rig import OPERATOR, Caller, Site, caller, site

pytestmark = pytest.mark.anyio
NARROW = "narrow-narrow-narrow"
FLEET = "".join(
    backend(f"r{number}", tenant, use="sim", robot=f"r{number}")
    for number, tenant in enumerate(["alpha"] * 6 + ["beta"])
)
MORE = role("narrow", rule("discover read", "/tenant/*/sensor/**")) + key(
    "narrow", NARROW, tenants=["alpha"]
)


@pytest.fixture
async def fleet() -> AsyncGenerator[Site]:
    async with site(robots=FLEET, more=MORE) as made:
        yield made


@pytest.fixture
async def operator(fleet: Site) -> AsyncGenerator[Caller]:
    async with caller(fleet, OPERATOR) as made:
        yield made


async def listed(by: Caller, **arguments: Any) -> dict[str, Any]:
    result = await by.call("robots", **arguments)
    assert not result.get("isError"), result
    return result["structuredContent"]


async def test_each_robot_is_a_line_with_what_one_needs_to_choose_it(operator: Caller) -> None:
    robots = (await listed(operator))["robots"]
    assert [one["path"] for one in robots] == [f"/tenant/alpha/r{n}" for n in range(6)]
    first = robots[0]
    assert (first["kind"], first["state"]) == ("rover", "ready")
    assert {"mobile/1.1", "battery/1.0"} <= {*first["profiles"]}
    assert 0 < first["battery"] <= 1
    assert first["position"].keys() == {"x", "y", "z", "frame"}
    assert "fact_sheet" not in first


async def test_details_are_those_of_the_inventory(operator: Caller) -> None:
    found = await listed(operator, q="rover r3", details=True)
    (robot,) = found["robots"]
    assert robot["path"] == "/tenant/alpha/r3"
    assert "actuator/cmd_vel" in robot["fact_sheet"]["limits"]


async def test_who_has_control_is_named(operator: Caller) -> None:
    lease = {"do": "acquire", "scope": "/tenant/alpha/r2", "ttl": 30}
    assert not (await operator.call("system-leases", **lease)).get("isError")
    (robot,) = (await listed(operator, q="r2"))["robots"]
    assert robot["control"] == "operator (lease)"


async def test_a_word_that_fits_none_is_answered(operator: Caller) -> None:
    found = await listed(operator, q="submarine")
    assert found["robots"] == []
    assert "fewer words" in found["note"]


async def test_a_list_longer_than_the_budget_goes_on_where_it_was_cut() -> None:
    async with site(robots=FLEET, mcp="budget = 200") as fleet, caller(fleet) as operator:
        pages, cursor = list[list[str]](), None
        while True:
            more = {} if cursor is None else {"cursor": cursor}
            page = await listed(operator, **more)
            pages.append([one["path"] for one in page["robots"]])
            if (cursor := page.get("cursor")) is None:
                break
        assert len(pages) > 1
        assert [path for page in pages for path in page] == [
            f"/tenant/alpha/r{n}" for n in range(6)
        ]


async def test_a_caller_who_may_not_read_the_inventory_has_no_such_tool(fleet: Site) -> None:
    async with caller(fleet, NARROW) as narrow:
        assert "robots" not in await narrow.tools()
        refused = await narrow.call("robots")
        assert refused["isError"]


async def test_without_the_inventory_there_is_no_such_tool() -> None:
    more = "[features]\ninventory = false\n"
    async with site(robots=FLEET, more=more) as fleet, caller(fleet) as operator:
        assert "robots" not in await operator.tools()
