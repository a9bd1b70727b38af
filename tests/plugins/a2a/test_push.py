"""What a task says is posted to whom its owner named, and to nobody else."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from typing import Any

import httpx
import pytest

from plugins.a2a.agent import KEY_BETA, agent, caller, rpc, sent, text
from plugins.a2a.receiver import ANSWER, Receiver, receiver
from transports.robot import Site

pytestmark = pytest.mark.anyio
NOWHERE = "execute /service/nowhere"
LOCAL = (
    'push = {http = true, private = ["127.0.0.0/8"], backoff = 0.01, attempts = 3, per_task = 2}'
)


@pytest.fixture
async def hook() -> AsyncGenerator[Receiver]:
    async with receiver() as made:
        yield made


@pytest.fixture
async def local() -> AsyncGenerator[Site]:
    async with agent(LOCAL) as made:
        yield made


@pytest.fixture
async def client(local: Site) -> AsyncGenerator[httpx.AsyncClient]:
    async with caller(local) as made:
        yield made


def pushed(hook: Receiver, **fields: Any) -> dict[str, Any]:
    return {"taskPushNotificationConfig": {"url": hook.url, **fields}}


async def test_each_step_of_a_task_is_posted_in_order(
    client: httpx.AsyncClient, hook: Receiver
) -> None:
    proof = {"scheme": "Bearer", "credentials": "let-me-in"}
    config = pushed(hook, token="of-mine", authentication=proof)
    task = await sent(client, text(NOWHERE, configuration=config))
    bodies = await hook.until("TASK_STATE_REJECTED")
    assert [next(iter(body)) for body in bodies] == ["task", "statusUpdate"]
    assert bodies[0]["task"]["id"] == bodies[1]["statusUpdate"]["taskId"] == task["id"]
    head = hook.heads[0]
    assert head[""] == "POST /hook HTTP/1.1"
    assert head["x-a2a-notification-token"] == "of-mine"
    assert head["authorization"] == "Bearer let-me-in"
    assert head["content-type"] == "application/a2a+json"


async def test_what_was_not_taken_is_posted_again(
    client: httpx.AsyncClient, hook: Receiver
) -> None:
    hook.answers += [ANSWER % b"503 Busy", ANSWER % b"429 Slower"]
    await sent(client, text(NOWHERE, configuration=pushed(hook)))
    await hook.until("TASK_STATE_REJECTED")
    assert [next(iter(body)) for body in hook.bodies] == ["task"] * 3 + ["statusUpdate"]


async def test_a_redirect_is_not_followed(client: httpx.AsyncClient, hook: Receiver) -> None:
    async with receiver() as inside:
        there = f"HTTP/1.1 302 There\r\nlocation: {inside.url}\r\ncontent-length: 0\r\n\r\n"
        hook.answers.append(there.encode())
        await sent(client, text(NOWHERE, configuration=pushed(hook)))
        await hook.until("TASK_STATE_REJECTED")
        assert inside.bodies == []


async def test_an_address_inside_is_refused_when_it_is_named(gateway: Site, hook: Receiver) -> None:
    async with caller(gateway) as client:
        params = text(NOWHERE, configuration=pushed(hook))
        answer = await rpc(client, "SendMessage", **params)
        assert answer["error"]["code"] == -32602
        task = await sent(client, text(NOWHERE))
        path = f"/a2a/tasks/{task['id']}/pushNotificationConfigs"
        assert (await client.post(path, json={"url": hook.url})).status_code == 400
        assert hook.bodies == []


async def test_configurations_are_made_read_listed_and_deleted(
    client: httpx.AsyncClient, hook: Receiver
) -> None:
    id_ = (await sent(client, text(NOWHERE)))["id"]
    path = f"/a2a/tasks/{id_}/pushNotificationConfigs"
    made = (await client.post(path, json={"url": hook.url, "id": "a"})).json()
    assert made == {"id": "a", "taskId": id_, "url": hook.url}
    assert (await client.get(f"{path}/a")).json() == made
    second = await rpc(client, "CreateTaskPushNotificationConfig", taskId=id_, url=hook.url, id="b")
    listed = (await client.get(path)).json()["configs"]
    assert listed == [made, second["result"]]
    full = await client.post(path, json={"url": hook.url, "id": "c"})
    assert (full.status_code, "at most 2" in full.text) == (400, True)
    assert (await client.delete(f"{path}/a")).status_code == 200
    assert (await client.get(f"{path}/a")).status_code == 404
    gone = await rpc(client, "GetTaskPushNotificationConfig", taskId=id_, id="a")
    assert gone["error"]["code"] == -32001


@pytest.mark.parametrize("token", ["two\r\nlines", "ümlaut", "x" * 2000])
async def test_a_token_that_does_not_fit_into_a_header_is_refused(
    client: httpx.AsyncClient, hook: Receiver, token: str
) -> None:
    params = text(NOWHERE, configuration=pushed(hook, token=token))
    assert (await rpc(client, "SendMessage", **params))["error"]["code"] == -32602


async def test_nobody_else_reaches_the_configurations_of_a_task(
    client: httpx.AsyncClient, local: Site, hook: Receiver
) -> None:
    id_ = (await sent(client, text(NOWHERE, configuration=pushed(hook))))["id"]
    async with caller(local, KEY_BETA) as other:
        for method, more in (
            ("ListTaskPushNotificationConfigs", {}),
            ("GetTaskPushNotificationConfig", {"id": id_}),
            ("DeleteTaskPushNotificationConfig", {"id": id_}),
            ("CreateTaskPushNotificationConfig", {"url": hook.url}),
        ):
            answer = await rpc(other, method, taskId=id_, **more)
            assert answer["error"]["code"] == -32001
    assert len((await rpc(client, "ListTaskPushNotificationConfigs", taskId=id_))["result"]) == 1


async def test_without_notifications_the_card_and_the_errors_say_so(hook: Receiver) -> None:
    async with agent("push = {enabled = false}") as site, caller(site) as client:
        card = (await client.get("/.well-known/agent-card.json")).json()
        assert not card["capabilities"].get("pushNotifications")
        id_ = (await sent(client, text(NOWHERE)))["id"]
        answer = await rpc(client, "ListTaskPushNotificationConfigs", taskId=id_)
        assert answer["error"]["code"] == -32003
        params = text(NOWHERE, configuration=pushed(hook))
        assert (await rpc(client, "SendMessage", **params))["error"]["code"] == -32003
