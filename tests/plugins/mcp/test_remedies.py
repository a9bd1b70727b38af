"""What to do is said in a model's words, and a client that wants a log gets one."""

from __future__ import annotations

import re
from typing import Any

import pytest

from plugins.mcp.rig import Caller, Site, caller
from plugins.mcp.test_tools import error
from rcp_kernel.errors import BY_CODE
from rcp_kernel.wire import error_body
from rcp_mcp.fixed import FIXED
from rcp_mcp.remedies import in_tools

pytestmark = pytest.mark.anyio
_ENVELOPE = re.compile(
    r"`hello`|`body`|`token`|`retry_after`|best_effort|envelope|Authorization|in a batch"
    r"|\bsession\b|version \"1\"|send (it|them|the \w+) again",
    re.IGNORECASE,
)
_TOOL = re.compile(r"(?:[Cc]all|[Uu]se|;) `(\w+)`")


@pytest.mark.parametrize("code", sorted(BY_CODE))
def test_no_remedy_names_what_a_model_does_not_have(code: str) -> None:
    for more in ({}, {"details": {"approval": "a-1"}}, {"retry_after": 2.0}):
        told = in_tools({**error_body(BY_CODE[code]("a message")), **more})
        if told is None:
            continue
        assert not _ENVELOPE.search(told), told
        assert "{" not in told.replace('{"do"', ""), told
        for tool in _TOOL.findall(told):
            assert tool in FIXED or tool == "idempotency_key", told


def test_what_a_model_needs_is_kept() -> None:
    asked = {"code": "approval_required", "details": {"approval": "a-17"}, "remedy": "?"}
    assert "`approval`: 'a-17'" in str(in_tools(asked))
    assert "Wait 2.5 s" in str(in_tools({"code": "rate_limited", "retry_after": 2.5}))
    bounds = {"code": "out_of_range", "remedy": "Send a value within the bounds."}
    assert in_tools(bounds) == "Send a value within the bounds."
    assert in_tools({"code": "internal"}) is None


async def test_a_call_that_asks_for_a_log_gets_one(operator: Caller, gateway: Site) -> None:
    async def logged(level: str | None, **arguments: Any) -> list[dict[str, Any]]:
        operator.notifications.clear()
        meta = {} if level is None else {"io.modelcontextprotocol/logLevel": level}
        await operator.ask("tools/call", name="write", arguments=arguments, meta=meta)
        method = "notifications/message"
        return [one["params"] for one in operator.notifications if one["method"] == method]

    good, bad = {"path": "/param/limit", "value": 1}, {"path": "/param/limit", "value": 9}
    assert await logged(None, **good) == []
    (note,) = await logged("info", **good)
    assert (note["level"], note["data"]["status"]) == ("info", "completed")
    assert await logged("error", **good) == []
    (note,) = await logged("error", **bad)
    assert note["data"]["code"] == "out_of_range"


async def test_a_stranger_is_told_whom_to_ask(gateway: Site) -> None:
    async with caller(gateway, "wrong-token-of-a-stranger") as stranger:
        answer = await stranger.send("tools/list")
        assert "hello" not in answer["error"]["message"]
        assert "person" in answer["error"]["message"]
    async with caller(gateway) as operator:
        told = error(await operator.call("read", path="/sensor/none"))
        assert "`discover`" in told["remedy"]
