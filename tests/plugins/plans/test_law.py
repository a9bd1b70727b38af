"""Whatever a plan says: nothing happens that its sender could not do, nor before the check passed."""

from __future__ import annotations

import asyncio
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from configuration import key
from kernel.world import CONFIG, Client, World, world_of

PATHS = {"/param/limit": "write", "/service/echo": "execute", "/action/cut_in": "execute"}
GOOD: dict[str, Any] = {"/param/limit": 1.0, "/service/echo": "x", "/action/cut_in": 14}
BAD: dict[str, Any] = {"/param/limit": 99.0, "/service/echo": 1, "/action/cut_in": "far"}
TOKEN = "somebody-somebody"


def _with(children: st.SearchStrategy[dict[str, Any]]) -> st.SearchStrategy[dict[str, Any]]:
    steps = st.lists(children, min_size=1, max_size=3)
    group = st.fixed_dictionaries(
        {"do": st.sampled_from(["sequence", "parallel"]), "steps": steps},
        optional={"fallback": steps, "retry": st.just({"times": 1, "on": ["device_rejected"]})},
    )
    return group | st.builds(lambda one, steps: {**one, "fallback": steps}, children, steps)


OPERATIONS = st.builds(
    lambda path, good, when: {
        "do": PATHS[path],
        "path": path,
        "value": (GOOD if good else BAD)[path],
        **({"when": when} if when else {}),
    },
    st.sampled_from(sorted(PATHS)),
    st.integers(0, 9).map(bool),
    st.sampled_from([None, None, "param.limit >= 0.0", "param.limit > 9.0"]),
)
STEPS = st.recursive(OPERATIONS, _with, max_leaves=8)
ALLOWED = st.sets(st.sampled_from([*sorted(PATHS), "read"]))


def configuration(allowed: set[str]) -> str:
    """Let somebody command some of the paths, and perhaps read the limit."""
    rules = [f'{{ operations = ["{PATHS[p]}"], paths = ["{p}"] }}' for p in allowed - {"read"}]
    if "read" in allowed:
        rules.append('{ operations = ["read"], paths = ["/param/limit"] }')
    rules.append('{ operations = ["read", "execute"], paths = ["/system/plans"] }')
    somebody = key("somebody", TOKEN, role="some")
    return f"{CONFIG}\n[roles.some]\nallow = [{', '.join(rules)}]\n{somebody}"


def flat(steps: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """List every step, however deep."""
    out: list[dict[str, Any]] = []
    for one in steps:
        out += [one, *flat(one.get("steps", [])), *flat(one.get("fallback", []))]
    return out


def done(world: World, client: Client) -> list[tuple[str, Any]]:
    """List what reached the robot."""
    ran = [c for c in world.server.gateway.commands.every() if c.path != "/system/plans"]
    writes = [("/" + name, value) for name, value in world.robot.writes]
    return writes + [(c.path.removeprefix("/tenant/alpha"), c.input) for c in ran]


async def _holds(steps: list[dict[str, Any]], allowed: set[str]) -> None:
    async with world_of(configuration(allowed)) as world:
        client = world.client(TOKEN)
        body = {"steps": steps}
        plan: dict[str, Any] = {"type": "execute", "path": "/system/plans", "body": body}
        dry = await client.ask(**plan, dry_run=True)
        assert done(world, client) == []
        reply = await client.ask(**plan)
        reached = done(world, client)

        every = flat(steps)
        commands = [one for one in every if one["do"] in ("write", "execute")]
        fits = all(one["value"] == GOOD[one["path"]] for one in commands)
        may = all(one["path"] in allowed for one in commands)
        looks = "read" in allowed or not any("when" in one for one in every)
        assert (reply["status"] != "rejected") == (fits and may and looks)
        assert (dry["status"] == "completed") == (reply["status"] != "rejected")
        if reply["status"] == "rejected":
            assert reached == []
        assert {path for path, _ in reached} <= allowed
        for path, value in reached:
            assert value == GOOD[path]


@given(steps=st.lists(STEPS, min_size=1, max_size=3), allowed=ALLOWED)
@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow])
def test_a_plan_does_nothing_that_its_sender_may_not(
    steps: list[dict[str, Any]], allowed: set[str]
) -> None:
    asyncio.run(_holds(steps, allowed))
