"""Both bindings do what the specification says, down to the errors."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from typing import Any

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from plugins.a2a.agent import agent, caller, data, rpc, sent, text, wrapped
from transports.robot import KEY, Site

pytestmark = pytest.mark.anyio
NOWHERE = "execute /service/nowhere"
METHODS = [
    "SendMessage", "SendStreamingMessage", "GetTask", "ListTasks", "CancelTask", "SubscribeToTask",
    "CreateTaskPushNotificationConfig", "GetTaskPushNotificationConfig",
    "ListTaskPushNotificationConfigs", "DeleteTaskPushNotificationConfig", "GetExtendedAgentCard",
]  # fmt: skip
FIELDS = st.sampled_from(
    [
        "message", "messageId", "role", "parts", "text", "data", "id", "taskId", "contextId", "url",
        "configuration", "historyLength", "tenant", "pageSize", "pageToken", "status", "metadata",
        "steps", "do", "path", "value", "deadline", "token", "taskPushNotificationConfig",
    ]
)  # fmt: skip
INFO = "type.googleapis.com/google.rpc.ErrorInfo"


@pytest.fixture(scope="module")
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture(scope="module")
async def gateway() -> AsyncGenerator[Site]:
    """One for all: nothing here depends on what others left, but for those that take `fresh`."""
    async with agent() as made:
        yield made


@pytest.fixture
async def fresh() -> AsyncGenerator[httpx.AsyncClient]:
    async with agent() as site, caller(site) as made:
        yield made


async def refused(
    client: httpx.AsyncClient, method: str, path: str, rpc_method: str, **params: Any
) -> tuple[int, int, str]:
    """Make one call over both bindings; returns the HTTP status, the JSON-RPC code, the reason."""
    answer = await client.request(method, path, json=params if method == "POST" else None)
    error = answer.json()["error"]
    assert error["code"] == answer.status_code
    over_rpc = (await rpc(client, rpc_method, **params))["error"]
    (info,) = [d for d in error["details"] if d["@type"] == INFO]
    (other,) = [d for d in over_rpc["data"] if d["@type"] == INFO]
    assert info["reason"] == other["reason"]
    assert info["domain"] == "a2a-protocol.org"
    return answer.status_code, over_rpc["code"], info["reason"]


async def test_a_task_is_had_again_over_either_binding(client: httpx.AsyncClient) -> None:
    task = await sent(client, text(NOWHERE))
    over_rest = (await client.get(f"/a2a/tasks/{task['id']}")).json()
    over_rpc = (await rpc(client, "GetTask", id=task["id"]))["result"]
    assert over_rest == over_rpc == task


async def test_an_answer_over_rest_has_the_media_type_of_the_protocol(
    client: httpx.AsyncClient,
) -> None:
    answer = await client.get("/a2a/tasks")
    assert answer.headers["content-type"] == "application/a2a+json"
    typed = await client.post(
        "/a2a/message:send", json=text(NOWHERE), headers={"content-type": "application/a2a+json"}
    )
    assert typed.status_code == 200


async def test_an_unknown_task_is_not_found(client: httpx.AsyncClient) -> None:
    reply = await refused(client, "GET", "/a2a/tasks/none", "GetTask", id="none")
    assert reply == (404, -32001, "TASK_NOT_FOUND")
    reply = await refused(client, "POST", "/a2a/tasks/none:cancel", "CancelTask", id="none")
    assert reply == (404, -32001, "TASK_NOT_FOUND")


async def test_a_task_that_has_ended_cannot_be_cancelled_followed_or_answered(
    client: httpx.AsyncClient,
) -> None:
    id_ = (await sent(client, text(NOWHERE)))["id"]
    reply = await refused(client, "POST", f"/a2a/tasks/{id_}:cancel", "CancelTask", id=id_)
    assert reply == (400, -32002, "TASK_NOT_CANCELABLE")
    reply = await refused(client, "GET", f"/a2a/tasks/{id_}:subscribe", "SubscribeToTask", id=id_)
    assert reply == (400, -32004, "UNSUPPORTED_OPERATION")
    more = text(NOWHERE, taskId=id_)
    reply = await refused(client, "POST", "/a2a/message:send", "SendMessage", **more)
    assert reply == (400, -32004, "UNSUPPORTED_OPERATION")


@pytest.mark.parametrize(
    "part",
    [
        {"raw": "AAAA", "mediaType": "image/png"},
        {"url": "https://example.com/plan.json"},
        {"text": "x", "mediaType": "text/html"},
    ],
    ids=["raw", "url", "html"],
)
async def test_a_part_that_is_no_plan_is_refused(
    client: httpx.AsyncClient, part: dict[str, Any]
) -> None:
    reply = await refused(client, "POST", "/a2a/message:send", "SendMessage", **wrapped(part))
    assert reply == (400, -32005, "CONTENT_TYPE_NOT_SUPPORTED")


@pytest.mark.parametrize(
    "params",
    [
        {},
        {"message": {"role": "ROLE_USER", "parts": [{"text": "x"}]}},
        {"message": {"messageId": "m", "role": "ROLE_USER", "parts": []}},
        {"message": {"messageId": "m", "parts": [{"text": "x"}]}},
        text("x", configuration={"historyLength": -1}),
    ],
    ids=["nothing", "no id", "no parts", "no role", "negative history"],
)
async def test_a_message_that_lacks_something_is_refused(
    client: httpx.AsyncClient, params: dict[str, Any]
) -> None:
    reply = await refused(client, "POST", "/a2a/message:send", "SendMessage", **params)
    assert reply[:2] == (400, -32602)


@pytest.mark.parametrize("version", [None, "0.3", "2.0", "x"])
async def test_another_version_is_not_taken_for_this_one(
    gateway: Site, version: str | None
) -> None:
    headers = {"authorization": f"Bearer {KEY}"} | ({"A2A-Version": version} if version else {})
    async with httpx.AsyncClient(base_url=gateway.url, headers=headers) as client:
        reply = await refused(client, "GET", "/a2a/tasks", "ListTasks")
        assert reply == (400, -32009, "VERSION_NOT_SUPPORTED")
        assert (await client.get("/a2a/tasks?A2A-Version=1.0")).status_code == (
            400 if version else 200
        )


async def test_history_is_cut_as_asked(client: httpx.AsyncClient) -> None:
    task = await sent(client, text(NOWHERE, messageId="m-1", configuration={"historyLength": 0}))
    assert "history" not in task
    whole = (await client.get(f"/a2a/tasks/{task['id']}?historyLength=5")).json()
    assert [m["messageId"] for m in whole["history"]] == ["m-1"]


async def test_tasks_are_listed_in_pages_newest_first(fresh: httpx.AsyncClient) -> None:
    ids = [(await sent(fresh, text(NOWHERE)))["id"] for _ in range(5)]
    seen: list[str] = []
    token = ""
    while True:
        page = (await fresh.get(f"/a2a/tasks?pageSize=2&pageToken={token}")).json()
        assert page["totalSize"] == 5
        assert page["pageSize"] <= 2
        seen += [task["id"] for task in page["tasks"]]
        assert not any("artifacts" in task for task in page["tasks"])
        token = page["nextPageToken"]
        if not token:
            break
    assert seen == ids[::-1]


async def test_tasks_are_listed_by_context_status_and_time(fresh: httpx.AsyncClient) -> None:
    first = await sent(fresh, text(NOWHERE))
    second = await sent(fresh, text(NOWHERE, contextId="elsewhere"))

    async def listed(**wanted: str) -> list[str]:
        over_rest = (await fresh.get("/a2a/tasks", params=wanted)).json()
        over_rpc = (await rpc(fresh, "ListTasks", **wanted))["result"]
        assert over_rest == over_rpc
        return [task["id"] for task in over_rest["tasks"]]

    assert await listed(contextId="elsewhere") == [second["id"]]
    assert await listed(status="TASK_STATE_REJECTED") == [second["id"], first["id"]]
    assert await listed(status="TASK_STATE_WORKING") == []
    assert await listed(statusTimestampAfter=second["status"]["timestamp"]) == [second["id"]]


@pytest.mark.parametrize("size", ["0", "101", "-1"])
async def test_a_page_has_a_size_within_bounds(client: httpx.AsyncClient, size: str) -> None:
    assert (await client.get(f"/a2a/tasks?pageSize={size}")).status_code == 400
    assert (await rpc(client, "ListTasks", pageSize=int(size)))["error"]["code"] == -32602


async def test_a_state_that_there_is_not_is_refused(client: httpx.AsyncClient) -> None:
    assert (await client.get("/a2a/tasks?status=TASK_STATE_BORED")).status_code == 400
    answer = await rpc(client, "ListTasks", status="TASK_STATE_BORED")
    assert answer["error"]["code"] == -32602


async def test_a_page_token_that_was_never_given_is_refused(client: httpx.AsyncClient) -> None:
    assert (await client.get("/a2a/tasks?pageToken=nonsense")).status_code == 400
    assert (await rpc(client, "ListTasks", pageToken="nonsense"))["error"]["code"] == -32602


async def test_what_is_no_json_rpc_is_told_by_its_code(client: httpx.AsyncClient) -> None:
    async def code(body: str) -> int:
        headers = {"content-type": "application/json"}
        answer = await client.post("/a2a", content=body, headers=headers)
        assert answer.status_code == 200
        return answer.json()["error"]["code"]

    assert await code("{") == -32700
    assert await code('{"jsonrpc": "1.0", "id": 1, "method": "GetTask"}') == -32600
    assert await code('{"jsonrpc": "2.0", "id": 1}') == -32600
    assert await code('{"jsonrpc": "2.0", "id": 1, "method": "Dance"}') == -32601
    odd = '{"jsonrpc": "2.0", "id": 1, "method": "GetTask", "params": {"id": 7}}'
    assert await code(odd) == -32602
    assert await code("[]") == -32600


async def test_an_address_of_nothing_is_told_in_json(client: httpx.AsyncClient) -> None:
    for path in ("/a2a/v1/nothing", "/a2a/alpha/nothing"):
        answer = await client.get(path)
        assert answer.status_code == 404
        assert answer.json()["error"]["status"] == "NOT_FOUND"
    wrong = await client.put("/a2a/tasks")
    assert wrong.status_code == 405
    assert wrong.headers["allow"]
    assert (await client.get("/a2a")).status_code == 405


async def test_a_body_that_is_not_json_by_its_type_is_refused(client: httpx.AsyncClient) -> None:
    headers = {"content-type": "text/plain"}
    answer = await client.post("/a2a/message:send", content="{}", headers=headers)
    assert answer.status_code == 415
    assert answer.json()["error"]["details"][0]["reason"] == "CONTENT_TYPE_NOT_SUPPORTED"


async def test_a_body_beyond_the_limit_is_refused(client: httpx.AsyncClient) -> None:
    big = data("x" * 1_100_000)
    answer = await client.post("/a2a/message:send", json=big)
    assert answer.status_code == 413


async def test_a_body_of_too_many_values_is_refused_and_the_remedy_is_text(
    client: httpx.AsyncClient,
) -> None:
    answer = await client.post("/a2a/message:send", json=data([1] * 5000))
    assert (answer.status_code, "as text" in answer.text) == (413, True)
    lines = "\n".join(['execute /action/nowhere {"a": [1, 2, 3]}'] * 100)
    answer = await client.post("/a2a/message:send", json=text(lines))
    assert (answer.status_code, "PAYLOAD_TOO_LARGE" in answer.text) == (200, False)


async def test_a_client_of_the_version_before_is_served(gateway: Site) -> None:
    part = {"kind": "text", "text": NOWHERE}
    message = {"kind": "message", "messageId": "m", "role": "user", "parts": [part]}
    asked = {
        "jsonrpc": "2.0", "id": 1, "method": "message/send", "params": {"message": message},
    }  # fmt: skip
    headers = {"authorization": f"Bearer {KEY}"}
    async with httpx.AsyncClient(base_url=gateway.url, headers=headers) as client:
        task = (await client.post("/a2a", json=asked)).json()["result"]
        assert (task["kind"], task["status"]["state"]) == ("task", "rejected")
        again = await client.get(f"/a2a/v1/tasks/{task['id']}")
        assert again.json()["id"] == task["id"]


async def test_tenants_are_named_by_the_address_or_the_parameters(gateway: Site) -> None:
    async with caller(gateway) as client:
        task = (await client.post("/a2a/beta/message:send", json=text(NOWHERE))).json()["task"]
        assert "result" in await rpc(client, "GetTask", id=task["id"], tenant="beta")
        assert "error" in await rpc(client, "GetTask", id=task["id"], tenant="alpha")
        asked = {"jsonrpc": "2.0", "id": 1, "method": "GetTask", "params": {"id": task["id"]}}
        assert "result" in (await client.post("/a2a/beta", json=asked)).json()


@pytest.mark.parametrize(
    "value",
    [b"NaN", b"1e999", b'"\\ud800"', b"[" * 3000 + b"]" * 3000, b'"\xff"'],
    ids=["NaN", "infinite", "surrogate", "deep", "no UTF-8"],
)
async def test_what_json_does_not_have_is_refused_and_kept_nowhere(
    client: httpx.AsyncClient, value: bytes
) -> None:
    before = (await rpc(client, "ListTasks"))["result"]["totalSize"]
    headers = {"content-type": "application/json"}
    message = (
        b'{"message": {"messageId": "1", "role": "ROLE_USER", "parts": [{"data": %s}]}}' % value
    )
    over_rest = await client.post("/a2a/message:send", content=message, headers=headers)
    assert over_rest.status_code == 400
    asked = b'{"jsonrpc": "2.0", "id": 1, "method": "SendMessage", "params": %s}' % message
    over_rpc = await client.post("/a2a", content=asked, headers=headers)
    assert (over_rpc.status_code, over_rpc.json()["error"]["code"]) == (200, -32700)
    assert (await rpc(client, "ListTasks"))["result"]["totalSize"] == before


async def test_the_names_of_the_version_before_mean_nothing_in_this_one(
    client: httpx.AsyncClient,
) -> None:
    answer = await rpc(client, "message/send", **text(NOWHERE))
    assert answer["error"]["code"] == -32601


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-9, 9) | st.sampled_from(["", "x", "m-1", "alpha"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(FIELDS, inner, max_size=4),
    max_leaves=12,
)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(method=st.sampled_from(METHODS), params=st.dictionaries(FIELDS, JSON, max_size=5))
async def test_whatever_is_sent_is_answered_in_the_words_of_the_protocol(
    client: httpx.AsyncClient, method: str, params: dict[str, Any]
) -> None:
    asked = {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}
    answer = await client.post("/a2a", json=asked)
    assert answer.status_code in (200, 403), answer.text
    if answer.headers["content-type"].startswith("application/json"):
        reply = answer.json()
        assert ("result" in reply) != ("error" in reply)
        assert reply.get("error", {}).get("code") not in (-32603, -32006), reply
    else:
        assert "-32603" not in answer.text
