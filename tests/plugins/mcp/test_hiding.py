"""Nothing reveals what the caller's rights hide: what is hidden looks as if it were not there."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from configuration import key, role, rule
from plugins.mcp.rig import Caller, Site, caller, site

GUEST = "guest-of-these-tests"
RIGHTS = role(
    "guest",
    rule("*", "/**"),
    rule("discover read", "/system/status"),
    deny=[rule("discover", "/sensor/secret", "/action/secret_dance")],
) + key("guest", "guest-of-these-tests", tenants=["alpha"])
HIDDEN = (
    ("/sensor/secret", "/sensor/nothing"),
    ("/action/secret_dance", "/action/nothing"),
    ("/tenant/alpha/sensor/secret", "/tenant/alpha/sensor/nothing"),
    ("/tenant/beta/sensor/level", "/tenant/beta/sensor/nothing"),
    ("/tenant/beta/action/go", "/tenant/gamma/action/go"),
    ("/system/audit", "/system/nothing"),
)
"""What the guest may not see, beside what there is not."""


@pytest.fixture
async def made() -> AsyncGenerator[Site]:
    async with site(more=RIGHTS) as found:
        yield found


@pytest.fixture
async def guest(made: Site) -> AsyncGenerator[Caller]:
    async with caller(made, GUEST) as client:
        yield client


def clean(answer: dict[str, Any], path: str) -> str:
    """Write an answer without the path that was asked for, its like, and what is random."""
    error = answer.get("structuredContent", {}).get("error", {})
    if error.pop("nearest", None):
        shown = answer["content"].pop()["text"]
        assert "secret" not in shown
        assert "beta" not in shown
    text = json.dumps(answer, sort_keys=True)
    segments = path.strip("/").split("/")
    for part in (path, path.removeprefix("/tenant/"), "/".join(segments[-2:]), segments[-1]):
        text = text.replace(part, "…")
    return text.replace("…/…", "…").replace("/tenant/alpha", "")


async def test_lists_hold_nothing_hidden(guest: Caller) -> None:
    for method in ("tools/list", "resources/list", "resources/templates/list", "prompts/list"):
        text = json.dumps(await guest.ask(method))
        assert "secret" not in text
        assert "beta" not in text
    found = json.dumps(await guest.call("discover", path="/**", schemas=True))
    assert "secret" not in found
    assert "beta" not in found
    assert "secret" not in json.dumps(await guest.call("read", path="/**"))
    assert "beta" not in json.dumps(await guest.call("status"))


async def test_completion_knows_nothing_hidden(guest: Caller) -> None:
    async def complete(argument: str, value: str, **context: str) -> list[str]:
        result = await guest.ask(
            "completion/complete",
            ref={"type": "ref/resource", "uri": "rcp://{tenant}/sensor/{+name}"},
            argument={"name": argument, "value": value},
            context={"arguments": context},
        )
        return result["completion"]["values"]

    assert await complete("tenant", "") == ["alpha"]
    assert "secret" not in await complete("name", "", tenant="alpha")
    assert await complete("name", "", tenant="beta") == []


@pytest.mark.parametrize(("hidden", "absent"), HIDDEN)
async def test_a_hidden_thing_is_refused_as_one_that_is_not_there(
    guest: Caller, hidden: str, absent: str
) -> None:
    for tool, more in (
        ("read", {}),
        ("write", {"value": 1}),
        ("execute", {"input": {}}),
        ("execute", {"input": {"x": "nonsense"}, "dry_run": True}),
        ("cancel", {}),
        ("discover", {"schemas": True}),
    ):
        one = await guest.call(tool, path=hidden, **more)
        other = await guest.call(tool, path=absent, **more)
        assert clean(one, hidden) == clean(other, absent), tool
    one = await guest.call("watch", paths=[hidden], seconds=0.1)
    other = await guest.call("watch", paths=[absent], seconds=0.1)
    assert clean(one, hidden) == clean(other, absent)


@pytest.mark.parametrize(("hidden", "absent"), HIDDEN)
async def test_a_hidden_resource_is_not_found(guest: Caller, hidden: str, absent: str) -> None:
    def uri(path: str) -> str:
        whole = path if path.startswith(("/tenant", "/system")) else f"/tenant/alpha{path}"
        return "rcp://" + whole.removeprefix("/tenant/")

    one = await guest.send("resources/read", uri=uri(hidden))
    other = await guest.send("resources/read", uri=uri(absent))
    assert one["error"].pop("data") == {"uri": uri(hidden)}
    assert other["error"].pop("data") == {"uri": uri(absent)}
    assert one == other


async def test_the_tool_of_a_hidden_action_is_unknown(guest: Caller) -> None:
    one = await guest.send("tools/call", name="action-secret_dance", arguments={})
    other = await guest.send("tools/call", name="action-nothing", arguments={})
    assert one["error"]["message"].replace("secret_dance", "nothing") == other["error"]["message"]


async def test_no_argument_makes_a_tool_tell_what_is_hidden(made: Site) -> None:
    tools = st.sampled_from(["discover", "read", "write", "execute", "cancel", "watch", "status"])
    texts = st.sampled_from(
        ["/**", "/*/*", "/sensor/*", "/action/*", "/tenant/*/sensor/*", "secret*", "", "**", "/x"]
    )
    paths = texts | st.text(max_size=12)
    arguments = st.fixed_dictionaries(
        {},
        optional={
            "path": paths,
            "paths": st.lists(paths, max_size=3),
            "q": st.text(max_size=8),
            "value": st.none() | st.integers() | st.text(max_size=5),
            "input": st.none() | st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
            "kind": st.sampled_from(["sensor", "action", "nonsense"]),
            "seconds": st.just(0.01),
            "dry_run": st.booleans(),
            "schemas": st.booleans(),
            "command": st.text(max_size=8),
        },
    )
    loop = asyncio.get_running_loop()

    async with caller(made, GUEST) as client:

        @settings(
            max_examples=60,
            suppress_health_check=[HealthCheck.function_scoped_fixture],
        )
        @given(tools, arguments)
        def check(tool: str, given_: dict[str, Any]) -> None:
            asked = client.send("tools/call", name=tool, arguments=given_)
            answer = asyncio.run_coroutine_threadsafe(asked, loop).result(20)
            text = json.dumps(answer)
            for word in ("sensor/secret", "secret_dance", "the hidden word", "beta"):
                assert word not in text or word in json.dumps(given_)

        await asyncio.to_thread(check)


AUDITOR = role(
    "auditor",
    rule("*", "/**", "/system/**"),
    deny=[rule("*", "/sensor/secret", "/action/secret_dance")],
) + key("auditor", "auditor-of-these-tests", roles={"alpha": "auditor"})


async def test_the_past_of_what_is_hidden_is_told_by_no_tool_and_no_resource() -> None:
    steps = [
        {"do": "execute", "path": "/action/secret_dance", "value": {"x": 3}},
        {"do": "read", "path": "/sensor/secret"},
        {"do": "execute", "path": "/service/double", "value": 21},
    ]
    async with (
        site(more=AUDITOR) as made,
        caller(made) as operator,
        caller(made, "auditor-of-these-tests") as auditor,
    ):
        await auditor.call("status")  # its login comes first
        reply = await operator.call("execute", path="/system/plans", input={"steps": steps})
        facts = reply["structuredContent"]
        assert "the hidden word" in json.dumps(facts)
        hidden = await auditor.call("status", command=facts["command"])
        absent = await auditor.call("status", command="cmd-0123456789abcdef")
        written = json.dumps(hidden).replace(facts["command"], "cmd-0123456789abcdef")
        assert json.loads(written) == absent
        answers: list[Any] = [await auditor.call("status")]
        for name in ("audit", "commands", "plans", "log"):
            answers.append(await auditor.call("read", path=f"/system/{name}"))
            answers.append(await auditor.send("resources/read", uri=f"rcp:///system/{name}"))
        assert "contents" in json.dumps(answers[2])
        found = json.dumps(answers)
        assert "service/double" in found
        assert "secret" not in found
        assert "the hidden word" not in found
