"""The protocol's own Python client drives a rover over each binding."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from typing import Any
from uuid import uuid4

import grpc
import grpc.aio
import httpx
import pytest
from a2a.client import Client, ClientConfig, ClientFactory
from a2a.client.errors import A2AClientError
from a2a.types.a2a_pb2 import (
    CancelTaskRequest,
    GetExtendedAgentCardRequest,
    GetTaskRequest,
    ListTasksRequest,
    Message,
    Part,
    Role,
    SendMessageRequest,
    StreamResponse,
    SubscribeToTaskRequest,
    Task,
    TaskPushNotificationConfig,
    TaskState,
)
from a2a.utils.errors import A2AError
from google.protobuf.json_format import MessageToDict, ParseDict
from google.protobuf.struct_pb2 import Value

from plugins.a2a.receiver import BOUND, receiver
from plugins.a2a.rover import BETA, CAREFUL, OPERATOR, rovers

pytestmark = pytest.mark.anyio
BINDINGS = ["JSONRPC", "HTTP+JSON", "GRPC"]
NEAR = {"do": "execute", "path": "/action/move_to", "value": {"position": {"x": 0.5, "y": 0}}}
FAR: dict[str, Any] = {
    "do": "execute",
    "path": "/action/move_to",
    "value": {"position": {"x": 9, "y": 0}, "speed": 0.1},
}


@pytest.fixture(scope="module")
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture(scope="module")
async def url() -> AsyncGenerator[str]:
    async with rovers() as made:
        yield made


class _WithKey:
    """Adds a key to the metadata of a call."""

    def __init__(self, key: str) -> None:
        self._key = key

    async def _sent(self, continuation: Any, details: Any, request: Any) -> Any:
        metadata = grpc.aio.Metadata(*(details.metadata or ()))
        metadata.add("authorization", f"Bearer {self._key}")
        return await continuation(details._replace(metadata=metadata), request)


class _Unary(_WithKey, grpc.aio.UnaryUnaryClientInterceptor):
    async def intercept_unary_unary(self, continuation: Any, details: Any, request: Any) -> Any:
        return await self._sent(continuation, details, request)


class _Stream(_WithKey, grpc.aio.UnaryStreamClientInterceptor):
    async def intercept_unary_stream(self, continuation: Any, details: Any, request: Any) -> Any:
        return await self._sent(continuation, details, request)


def channel(address: str, *, key: str) -> grpc.aio.Channel:
    return grpc.aio.insecure_channel(address, interceptors=[_Unary(key), _Stream(key)])


@asynccontextmanager
async def client_of(url: str, binding: str, key: str = OPERATOR) -> AsyncGenerator[Client]:
    headers = {"authorization": f"Bearer {key}"}
    async with httpx.AsyncClient(headers=headers, timeout=BOUND) as http:
        config = ClientConfig(
            httpx_client=http,
            supported_protocol_bindings=[binding],
            grpc_channel_factory=partial(channel, key=key),
        )
        yield await ClientFactory(config).create_from_url(url)


def plan(*steps: Any, **fields: Any) -> SendMessageRequest:
    part = Part(data=ParseDict({"steps": list(steps)}, Value()))
    return said(part, **fields)


def said(part: Part, **fields: Any) -> SendMessageRequest:
    return SendMessageRequest(
        message=Message(message_id=str(uuid4()), role=Role.ROLE_USER, parts=[part], **fields)
    )


def state_of(event: StreamResponse) -> str | None:
    kind: Any = event.WhichOneof("payload")
    if kind not in ("task", "status_update"):
        return None
    return TaskState.Name(getattr(event, kind).status.state).removeprefix("TASK_STATE_")


async def until(stream: AsyncIterator[StreamResponse], state: str) -> list[StreamResponse]:
    seen: list[StreamResponse] = []
    async with asyncio.timeout(BOUND):
        async for event in stream:
            seen.append(event)
            if state_of(event) == state:
                return seen
    raise AssertionError(f"no {state} in {seen}")


def id_of(seen: list[StreamResponse]) -> str:
    return seen[0].task.id


def result_of(task: Task, number: int) -> Any:
    return MessageToDict(task.artifacts[number].parts[0].data)["result"]


async def task_of(client: Client, id_: str) -> Task:
    return await client.get_task(GetTaskRequest(id=id_))


@pytest.mark.parametrize("binding", BINDINGS)
async def test_a_rover_is_driven_and_each_step_is_seen(url: str, binding: str) -> None:
    async with client_of(url, binding) as client:
        card = await client.get_extended_agent_card(GetExtendedAgentCardRequest())
        assert "action.move_to" in [skill.id for skill in card.skills]
        read = {"do": "read", "path": "/sensor/pose", "id": "where"}
        seen = await until(client.send_message(plan(NEAR, read)), "COMPLETED")
        artifacts = [
            e.artifact_update.artifact.artifact_id for e in seen if e.HasField("artifact_update")
        ]
        assert artifacts == ["step-1", "step-where"]
        assert any("progress" in e.status_update.metadata for e in seen)
        task = await task_of(client, id_of(seen))
        where = result_of(task, 1)["position"]
        assert abs(where["x"] - 0.5) < 0.15
        listed = await client.list_tasks(ListTasksRequest(page_size=1))
        assert listed.tasks[0].id == task.id


@pytest.mark.parametrize("binding", BINDINGS)
async def test_a_drive_is_cut_taken_up_again_and_cancelled(url: str, binding: str) -> None:
    async with client_of(url, binding) as client:
        stream = client.send_message(plan(FAR))
        seen = await until(stream, "WORKING")
        await stream.aclose()  # type: ignore[attr-defined] - an async generator
        id_ = id_of(seen)
        assert (await task_of(client, id_)).status.state == TaskState.TASK_STATE_WORKING
        again = client.subscribe(SubscribeToTaskRequest(id=id_))
        await until(again, "WORKING")
        cancelled = await client.cancel_task(CancelTaskRequest(id=id_))
        assert cancelled.status.state == TaskState.TASK_STATE_CANCELED
        await until(again, "CANCELED")
        stands = await until(
            client.send_message(said(Part(text="read /sensor/odometry"))), "COMPLETED"
        )
        result = result_of(await task_of(client, id_of(stands)), 0)
        assert abs(result["twist"]["linear"]["x"]) < 0.05


@pytest.mark.parametrize("binding", BINDINGS)
async def test_what_lacks_is_asked_for_and_given(url: str, binding: str) -> None:
    async with client_of(url, binding) as client:
        asked = await until(
            client.send_message(
                said(Part(text='execute /action/move_to {"position": {"x": 0.5}}'))
            ),
            "INPUT_REQUIRED",
        )
        given = Part(data=ParseDict({"position": {"y": 0.1}}, Value()))
        more = client.send_message(said(given, task_id=id_of(asked)))
        done = await until(more, "COMPLETED")
        assert done[-1].status_update.context_id == asked[0].task.context_id


@pytest.mark.parametrize("binding", BINDINGS)
async def test_an_approval_is_asked_for_and_given(url: str, binding: str) -> None:
    async with client_of(url, binding, CAREFUL) as client:
        asked = await until(
            client.send_message(said(Part(text="execute /action/dock"))), "INPUT_REQUIRED"
        )
        yes = client.send_message(said(Part(text="approve"), task_id=id_of(asked)))
        await until(yes, "COMPLETED")


@pytest.mark.parametrize("binding", BINDINGS)
async def test_each_step_is_posted_to_who_asked_for_it(url: str, binding: str) -> None:
    async with receiver() as hook, client_of(url, binding) as client:
        request = plan(NEAR)
        request.configuration.task_push_notification_config.CopyFrom(
            TaskPushNotificationConfig(url=hook.url, token="mine")
        )
        await until(client.send_message(request), "COMPLETED")
        bodies = await hook.until("TASK_STATE_COMPLETED")
        assert any("artifactUpdate" in body for body in bodies)
        assert hook.heads[0]["x-a2a-notification-token"] == "mine"


@pytest.mark.parametrize("binding", BINDINGS)
async def test_who_has_no_right_is_denied(url: str, binding: str) -> None:
    async with client_of(url, binding) as mine, client_of(url, binding, BETA) as other:
        done = await until(mine.send_message(said(Part(text="read /sensor/pose"))), "COMPLETED")
        with pytest.raises((A2AError, A2AClientError)):
            await task_of(other, id_of(done))
        elsewhere = said(Part(text="execute /tenant/alpha/action/dock"))
        await until(other.send_message(elsewhere), "REJECTED")
    async with client_of(url, binding, "nobody's-key-at-all") as stranger:
        with pytest.raises((A2AError, A2AClientError)):
            await stranger.list_tasks(ListTasksRequest())
