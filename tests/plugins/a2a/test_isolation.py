"""No skill, task or error reveals what a caller's rights hide."""

from __future__ import annotations

import asyncio
from typing import Any

import httpx
import msgspec
import pytest

from configuration import key, role, rule
from plugins.a2a.agent import KEY_BETA, VERSION, agent, caller, rpc, sent, text
from rcp_kernel.config.role import Rule
from transports.robot import KEY, Site

pytestmark = pytest.mark.anyio
NOWHERE = "execute /service/nowhere"


def told(answer: dict[str, Any], *names: str) -> str:
    """Return an answer as text, without what is new in each."""
    out = str(answer)
    for name in names:
        out = out.replace(name, "…")
    return out


async def test_the_task_of_another_is_as_one_that_never_was(gateway: Site) -> None:
    async with caller(gateway) as mine, caller(gateway, KEY_BETA) as other:
        id_ = (await sent(mine, text(NOWHERE)))["id"]
        for method in ("GetTask", "CancelTask", "SubscribeToTask"):
            hidden = await rpc(other, method, id=id_)
            none = await rpc(other, method, id="none")
            assert told(hidden, id_) == told(none, "none")
        hidden = await rpc(other, "SendMessage", **text(NOWHERE, taskId=id_))
        none = await rpc(other, "SendMessage", **text(NOWHERE, taskId="none"))
        assert told(hidden, id_) == told(none, "none")
        assert (await rpc(other, "ListTasks"))["result"]["totalSize"] == 0
        page = await rpc(mine, "ListTasks")
        assert page["result"]["totalSize"] == 1


async def test_a_context_of_another_shows_nothing_of_it(gateway: Site) -> None:
    async with caller(gateway) as mine, caller(gateway, KEY_BETA) as other:
        await sent(mine, text(NOWHERE, contextId="of-mine"))
        await sent(other, text(NOWHERE, contextId="of-mine"))
        listed = (await rpc(other, "ListTasks", contextId="of-mine"))["result"]
        assert listed["totalSize"] == 1


async def test_a_tenant_of_others_is_as_one_that_is_not(gateway: Site) -> None:
    async with caller(gateway, KEY_BETA) as client:
        answers: list[tuple[int, str]] = []
        for tenant in ("alpha", "gamma"):
            over_rest = await client.get(f"/a2a/{tenant}/tasks")
            asked = {"jsonrpc": "2.0", "id": 1, "method": "ListTasks", "params": {"tenant": tenant}}
            over_rpc = await client.post("/a2a", json=asked)
            assert over_rest.status_code == over_rpc.status_code == 403
            assert over_rpc.json()["error"]["code"] == -32051
            answers.append((over_rest.status_code, told(over_rest.json(), tenant)))
        assert answers[0] == answers[1]


async def test_a_long_request_of_who_proves_nothing_is_not_read() -> None:
    async with agent() as site, caller(site, None) as client:
        asked = {"jsonrpc": "2.0", "id": 9, "method": "ListTasks", "params": {"x": "x" * 100_000}}
        answer = await client.post("/a2a", json=asked)
        assert answer.json()["error"]["data"][0]["reason"] == "PAYLOAD_TOO_LARGE", answer.text


async def test_who_proves_nothing_is_refused_where_nobody_is_served_without_proof() -> None:
    async with agent(top="anonymous = false") as site, caller(site, None) as client:
        answer = await client.get("/a2a/tasks")
        assert answer.status_code == 401
        assert answer.headers["www-authenticate"] == "Bearer"
        assert answer.json()["error"]["status"] == "UNAUTHENTICATED"
        asked = {"jsonrpc": "2.0", "id": 9, "method": "ListTasks", "params": {}}
        over_rpc = await client.post("/a2a", json=asked)
        assert (over_rpc.status_code, over_rpc.json()["id"]) == (401, 9)
        assert over_rpc.json()["error"]["code"] == -32050
        card = await client.get("/.well-known/agent-card.json")  # how else would one begin?
        assert [skill["id"] for skill in card.json()["skills"]] == ["plan"]


async def test_a_token_that_is_not_known_is_refused_over_both_bindings(gateway: Site) -> None:
    async with caller(gateway, "not-the-key-of-anybody") as client:
        assert (await client.get("/a2a/tasks")).status_code == 401
        assert (await client.post("/a2a", json={})).status_code == 401


async def test_a_quota_holds_for_agents_too() -> None:
    more = "[quotas.principal]\nrequests = 0.01\nburst = 2"
    async with agent(more=more) as site, caller(site) as client:
        answers = [await client.get("/a2a/tasks") for _ in range(4)]
        refused = [answer for answer in answers if answer.status_code == 429]
        assert refused
        assert refused[0].json()["error"]["status"] == "RESOURCE_EXHAUSTED"
        assert int(refused[0].headers["retry-after"]) >= 1


async def test_the_name_of_another_proof_is_somebody_else(gateway: Site) -> None:
    async with caller(gateway) as mine, caller(gateway, None) as stranger:
        id_ = (await sent(mine, text(NOWHERE)))["id"]
        assert (await stranger.get(f"/a2a/tasks/{id_}")).status_code == 404


async def test_calls_side_by_side_keep_their_callers(gateway: Site) -> None:
    headers = {key: VERSION | {"authorization": f"Bearer {key}"} for key in (KEY, KEY_BETA)}
    async with httpx.AsyncClient(base_url=gateway.url, timeout=60.0) as client:

        async def one(key: str) -> tuple[str, str]:
            answer = await client.post(
                "/a2a/message:send", json=text(NOWHERE), headers=headers[key]
            )
            return key, answer.json()["task"]["id"]

        done = await asyncio.gather(*(one(key) for key in (KEY, KEY_BETA) * 10))
        for key in (KEY, KEY_BETA):
            page = (await client.get("/a2a/tasks", headers=headers[key])).json()
            assert {task["id"] for task in page["tasks"]} == {i for k, i in done if k == key}


SOME = role("some", rule("*", "/**", "/system/plans")) + key(
    "somebody", "somebody-somebody", roles={"alpha": "some"}
)
DENIED = Rule(("*",), ("/service/add", "/sensor/text"))


async def test_a_task_does_not_show_what_its_owner_may_not_see_any_more() -> None:
    lines = "execute /service/add 41\nread /sensor/text\nread /sensor/pose"
    async with agent(more=SOME) as made, caller(made, "somebody-somebody") as client:
        made.robot.host.publish("sensor/text", "swordfish")
        id_ = (await sent(client, text(lines)))["id"]
        before = (await rpc(client, "GetTask", id=id_))["result"]
        assert [one["name"].rpartition("/")[2] for one in before["artifacts"]] == [
            "add",
            "text",
            "pose",
        ]
        assert "swordfish" in str(before)
        kernel = made.server.gateway
        some = msgspec.structs.replace(kernel.settings.config.roles["some"], deny=(DENIED,))
        roles = {**kernel.settings.config.roles, "some": some}
        kernel.reconfigure(msgspec.structs.replace(kernel.settings.config, roles=roles))
        after = (await rpc(client, "GetTask", id=id_))["result"]
        listed = (await rpc(client, "ListTasks", includeArtifacts=True))["result"]
        for told_ in (after, listed["tasks"][0]):
            assert [one["name"] for one in told_["artifacts"]] == ["/tenant/alpha/sensor/pose"]
            assert "swordfish" not in str(told_)
        assert after["status"]["state"] == "TASK_STATE_COMPLETED"


async def test_what_was_asked_for_in_vain_is_told_although_it_is_hidden() -> None:
    async with agent(more=SOME) as made, caller(made, "somebody-somebody") as client:
        id_ = (await sent(client, text("read /tenant/beta/sensor/text")))["id"]
        for method in ("GetTask", "ListTasks"):
            answer = await rpc(client, method, **({"id": id_} if method == "GetTask" else {}))
            assert "no resource /tenant/beta/sensor/text" in str(answer)
