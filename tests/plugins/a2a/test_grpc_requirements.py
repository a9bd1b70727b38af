"""The requirements of the A2A compatibility kit on a gRPC binding, by their ids.

The kit (a2aproject/a2a-tck) is in no package registry. Each test names the requirements of the
specification that the kit checks on gRPC and proves them with the SDK's own stub.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterable, Callable
from typing import Any
from uuid import uuid4

import grpc
import pytest
from a2a.types.a2a_pb2 import (
    DESCRIPTOR,
    CancelTaskRequest,
    DeleteTaskPushNotificationConfigRequest,
    GetExtendedAgentCardRequest,
    GetTaskPushNotificationConfigRequest,
    GetTaskRequest,
    ListTaskPushNotificationConfigsRequest,
    ListTasksRequest,
    Message,
    Part,
    Role,
    SendMessageConfiguration,
    SendMessageRequest,
    SubscribeToTaskRequest,
    Task,
    TaskPushNotificationConfig,
    TaskState,
)
from google.protobuf.message_factory import GetMessageClass
from google.rpc.error_details_pb2 import ErrorInfo
from google.rpc.status_pb2 import Status

from plugins.a2a.agent import agent
from plugins.a2a.test_grpc import key, stub
from transports.robot import BOUND, KEY, Site

pytestmark = pytest.mark.anyio
COMPLETED, WORKING = TaskState.TASK_STATE_COMPLETED, TaskState.TASK_STATE_WORKING
CANCELED = TaskState.TASK_STATE_CANCELED
ENDED = {COMPLETED, CANCELED, TaskState.TASK_STATE_FAILED, TaskState.TASK_STATE_REJECTED}
ADD, GO = "execute /service/add 1", "execute /action/go 5"
FAILED, ABSENT = grpc.StatusCode.FAILED_PRECONDITION, grpc.StatusCode.NOT_FOUND
INVALID = grpc.StatusCode.INVALID_ARGUMENT
NOWHERE = "no-such-task"


class Calls:
    """The stub, as an operator of tenant alpha."""

    def __init__(self, made: Any, site: Site) -> None:
        self.stub, self.site = made, site
        self.metadata = (*key(KEY), ("a2a-version", "1.0"), ("x-rcp-tenant", "alpha"))

    async def __call__(self, method: str, request: Any) -> Any:
        call = getattr(self.stub, method)
        return await call(request, metadata=self.metadata, timeout=BOUND)

    def stream(self, method: str, request: Any) -> AsyncIterable[Any]:
        return getattr(self.stub, method)(request, metadata=self.metadata, timeout=BOUND)

    async def sent(self, text: str, **fields: Any) -> Task:
        return (await self("SendMessage", message(text, **fields))).task

    async def begun(self) -> Task:
        """Return a task that works until it is cancelled."""
        return await self.sent(GO, configuration=SendMessageConfiguration(return_immediately=True))

    async def drained(self, method: str, request: Any) -> None:
        """Call, and read a stream to its end."""
        if method in ("SendStreamingMessage", "SubscribeToTask"):
            async for _ in self.stream(method, request):
                pass
        else:
            await self(method, request)

    async def error(self, method: str, request: Any) -> tuple[grpc.StatusCode, str]:
        """Return the status of a refusal and the reason of its ErrorInfo: GRPC-ERR-001."""
        with pytest.raises(grpc.aio.AioRpcError) as refused:
            await self.drained(method, request)
        assert refused.value.details(), "it says what is wrong"
        return refused.value.code(), reason(refused.value)


def reason(error: grpc.aio.AioRpcError) -> str:
    raw = dict(error.trailing_metadata() or ()).get("grpc-status-details-bin")
    assert isinstance(raw, bytes), "no status details"
    infos = [
        ErrorInfo.FromString(d.value)
        for d in Status.FromString(raw).details
        if d.Is(ErrorInfo.DESCRIPTOR)
    ]
    (info,) = infos
    assert info.domain == "a2a-protocol.org"
    return info.reason


def message(text: str, part: Part | None = None, **fields: Any) -> SendMessageRequest:
    outer = {name: fields.pop(name) for name in ("configuration",) if name in fields}
    said = Message(
        message_id=str(uuid4()), role=Role.ROLE_USER, parts=[part or Part(text=text)], **fields
    )
    return SendMessageRequest(message=said, **outer)


def state(event: Any) -> int:
    which = event.WhichOneof("payload")
    return getattr(event, which).status.state if which in ("task", "status_update") else 0


@pytest.fixture
async def calls() -> AsyncGenerator[Calls]:
    push = '[plugins.a2a.push]\nhttp = true\nprivate = ["127.0.0.0/8"]\n'
    async with agent(f"[plugins.a2a.grpc]\nport = 0\n{push}") as site, stub(site) as made:
        yield Calls(made, site)


async def test_every_method_of_the_service_is_there(calls: Calls) -> None:
    """GRPC-SVC-001, GRPC-SVC-002."""
    lacking = {grpc.StatusCode.UNIMPLEMENTED, grpc.StatusCode.UNKNOWN, grpc.StatusCode.INTERNAL}
    methods = DESCRIPTOR.services_by_name["A2AService"].methods
    assert len(methods) == 11
    for method in methods:
        request = GetMessageClass(method.input_type)()
        code = None
        try:
            await calls.drained(method.name, request)
        except grpc.aio.AioRpcError as error:
            code = error.code()
        assert code not in lacking, method.name


async def test_a_message_makes_a_task_of_its_own(calls: Calls) -> None:
    """CORE-SEND-001, CORE-EXECUTION-MODE-001, CORE-MULTI-001a, -002, -003."""
    first, second = await calls.sent(ADD), await calls.sent(ADD, context_id="mine")
    assert first.status.state == second.status.state == COMPLETED
    assert first.id
    assert first.id != second.id
    assert first.context_id
    assert second.context_id == "mine"


async def test_who_does_not_wait_is_answered_at_once(calls: Calls) -> None:
    """CORE-EXECUTION-MODE-002, CORE-CANCEL-001."""
    task = await calls.begun()
    assert task.status.state not in ENDED
    cancelled = await calls("CancelTask", CancelTaskRequest(id=task.id))
    assert (cancelled.id, cancelled.status.state) == (task.id, CANCELED)


async def test_tasks_are_found_and_listed(calls: Calls) -> None:
    """CORE-GET-001, CORE-LIST-001 to -005, CORE-HIST-001 to -003."""
    made = [await calls.sent(ADD, context_id="mine") for _ in range(3)]
    other = await calls.sent(ADD)
    found = await calls("GetTask", GetTaskRequest(id=made[0].id))
    assert (found.id, found.status.state) == (made[0].id, COMPLETED)
    assert found.artifacts
    assert len(found.history) >= 1
    none = await calls("GetTask", GetTaskRequest(id=made[0].id, history_length=0))
    assert not none.history
    one = await calls("GetTask", GetTaskRequest(id=made[0].id, history_length=1))
    assert len(one.history) == 1
    bare = await calls.sent(ADD, configuration=SendMessageConfiguration(history_length=0))
    assert not bare.history

    page = await calls("ListTasks", ListTasksRequest(context_id="mine", page_size=2))
    assert len(page.tasks) == 2
    assert page.next_page_token
    last = await calls(
        "ListTasks",
        ListTasksRequest(context_id="mine", page_size=2, page_token=page.next_page_token),
    )
    assert not last.next_page_token
    listed = [*page.tasks, *last.tasks]
    assert {task.id for task in listed} == {task.id for task in made}
    assert other.id not in {task.id for task in listed}
    assert not any(task.artifacts for task in listed)
    times = [task.status.timestamp.ToNanoseconds() for task in listed]
    assert times == sorted(times, reverse=True)


async def test_a_stream_begins_with_its_task_and_ends_with_it(calls: Calls) -> None:
    """CORE-STREAM-001, CORE-STREAM-003, GRPC-ERR-003, STREAM-ORDER-001."""
    events = [event async for event in calls.stream("SendStreamingMessage", message(ADD))]
    assert events[0].WhichOneof("payload") == "task"
    assert state(events[-1]) == COMPLETED
    assert [state(event) for event in events if state(event) in ENDED] == [COMPLETED]


async def test_streams_of_one_task_see_the_same(calls: Calls) -> None:
    """STREAM-SUB-001, STREAM-SUB-002, STREAM-ORDER-002 to -004."""
    task = await calls.begun()
    request = SubscribeToTaskRequest(id=task.id)

    async def follow(started: asyncio.Event) -> list[Any]:
        seen: list[Any] = []
        async for event in calls.stream("SubscribeToTask", request):
            seen.append(event)
            started.set()
        return seen

    async with asyncio.timeout(BOUND), asyncio.TaskGroup() as group:
        begun = [asyncio.Event() for _ in range(2)]
        both = [group.create_task(follow(event)) for event in begun]
        closed = calls.stream("SubscribeToTask", request)
        async for event in closed:
            assert event.WhichOneof("payload") == "task"
            break
        closed.cancel()  # type: ignore[attr-defined]
        for event in begun:
            await event.wait()
        await calls("CancelTask", CancelTaskRequest(id=task.id))
    first, second = (
        [event.SerializeToString(deterministic=True) for event in t.result()[1:]] for t in both
    )
    assert [t.result()[0].WhichOneof("payload") for t in both] == ["task", "task"]
    assert first[-1] == second[-1]
    assert state(both[0].result()[-1]) == CANCELED


Request = Callable[[Task, Task], Any]


REFUSED: list[tuple[str, Request, Any, str | None]] = [
    # CORE-GET-002, CORE-CANCEL-003, STREAM-SUB-004, CORE-MULTI-004
    ("GetTask", lambda *_: GetTaskRequest(id=NOWHERE), ABSENT, "TASK_NOT_FOUND"),
    ("CancelTask", lambda *_: CancelTaskRequest(id=NOWHERE), ABSENT, "TASK_NOT_FOUND"),
    ("SubscribeToTask", lambda *_: SubscribeToTaskRequest(id=NOWHERE), ABSENT, "TASK_NOT_FOUND"),
    ("SendMessage", lambda *_: message(ADD, task_id=NOWHERE), ABSENT, "TASK_NOT_FOUND"),
    # CORE-CANCEL-002, CORE-SEND-002, STREAM-SUB-003
    ("CancelTask", lambda done, _: CancelTaskRequest(id=done.id), FAILED, "TASK_NOT_CANCELABLE"),
    ("SendMessage", lambda done, _: message(ADD, task_id=done.id), FAILED, "UNSUPPORTED_OPERATION"),
    ("SendStreamingMessage", lambda done, _: message(ADD, task_id=done.id), FAILED, "UNSUPPORTED_OPERATION"),
    ("SubscribeToTask", lambda done, _: SubscribeToTaskRequest(id=done.id), FAILED, "UNSUPPORTED_OPERATION"),
    # A running task takes no messages.
    ("SendMessage", lambda _, runs: message(ADD, task_id=runs.id), FAILED, "UNSUPPORTED_OPERATION"),
    # CORE-SEND-003, CORE-MULTI-006, CORE-ERR-002
    ("SendMessage", lambda *_: message("", Part(raw=b"tck", media_type="application/x-tck")), INVALID, "CONTENT_TYPE_NOT_SUPPORTED"),
    ("SendMessage", lambda done, _: message(ADD, task_id=done.id, context_id="wrong"), None, None),
    ("SendMessage", lambda *_: SendMessageRequest(), INVALID, "INVALID_PARAMS"),
    ("SendStreamingMessage", lambda *_: SendMessageRequest(), INVALID, "INVALID_PARAMS"),
    ("GetTask", lambda *_: GetTaskRequest(), None, None),
]  # fmt: skip


async def test_errors_have_their_status_and_reason(calls: Calls) -> None:
    """GRPC-ERR-001, GRPC-ERR-002, CORE-ERR-001."""
    done, runs = await calls.sent(ADD), await calls.begun()
    for method, request_of, code, why in REFUSED:
        found, reason = await calls.error(method, request_of(done, runs))
        assert code is None or found is code, (method, found, reason)
        assert why is None or reason == why
    await calls("CancelTask", CancelTaskRequest(id=runs.id))


async def test_another_version_is_refused(calls: Calls) -> None:
    """GRPC-META-001, VER-SERVER-002."""
    for version in ("99.0", "0.3", "x"):
        calls.metadata = (*key(KEY), ("a2a-version", version), ("x-rcp-tenant", "alpha"))
        for method in ("SendMessage", "SendStreamingMessage"):
            assert await calls.error(method, message(ADD)) == (FAILED, "VERSION_NOT_SUPPORTED")
    assert not calls.site.robot.ran


async def test_push_notifications_are_kept_for_a_task(calls: Calls) -> None:
    """The push requirements of the kit: created, read, listed, removed, and gone."""
    task = await calls.begun()
    wanted = TaskPushNotificationConfig(task_id=task.id, id="one", url="http://127.0.0.1:9/x")
    made = await calls("CreateTaskPushNotificationConfig", wanted)
    assert (made.task_id, made.id, made.url) == (task.id, "one", wanted.url)
    get = GetTaskPushNotificationConfigRequest(task_id=task.id, id="one")
    assert (await calls("GetTaskPushNotificationConfig", get)).url == wanted.url
    every = ListTaskPushNotificationConfigsRequest(task_id=task.id)
    assert [one.id for one in (await calls("ListTaskPushNotificationConfigs", every)).configs] == [
        "one"
    ]
    gone = DeleteTaskPushNotificationConfigRequest(task_id=task.id, id="one")
    for _ in range(2):  # the second time it is gone already
        await calls("DeleteTaskPushNotificationConfig", gone)
    assert not (await calls("ListTaskPushNotificationConfigs", every)).configs
    with pytest.raises(grpc.aio.AioRpcError):
        await calls("GetTaskPushNotificationConfig", get)
    await calls("CancelTask", CancelTaskRequest(id=task.id))


async def test_the_extended_card_names_this_binding(calls: Calls) -> None:
    """CARD-EXT: over gRPC as over the others."""
    card = await calls("GetExtendedAgentCard", GetExtendedAgentCardRequest())
    assert "GRPC" in {one.protocol_binding for one in card.supported_interfaces}
    assert card.capabilities.streaming
    assert card.capabilities.push_notifications
