"""The SDK's request handler, with additional checks required by the specification."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Generator, Iterable
from contextlib import aclosing, contextmanager
from inspect import unwrap
from typing import Any
from uuid import uuid4

from a2a.server.agent_execution import AgentExecutor
from a2a.server.context import ServerCallContext
from a2a.server.request_handlers import DefaultRequestHandler
from a2a.types.a2a_pb2 import (
    CancelTaskRequest,
    GetTaskRequest,
    ListTasksRequest,
    ListTasksResponse,
    Message,
    Role,
    SendMessageRequest,
    SubscribeToTaskRequest,
    Task,
    TaskState,
    TaskStatusUpdateEvent,
)
from a2a.utils.errors import (
    PushNotificationNotSupportedError,
    TaskNotFoundError,
    UnsupportedOperationError,
)

from rcp_a2a.callers import NEW_TASK, caller_of, owner_of
from rcp_a2a.masking import Mask
from rcp_a2a.messages import check, check_fields
from rcp_a2a.receipts import Receipts
from rcp_a2a.tasks import ENDED, WAITING, Tasks
from rcp_gateway.client_api import ClientApi

__all__ = ["Handler"]


_HISTORY = 64  # latest messages of a task in a response: each is encoded in one turn
_AT_REST = ENDED | WAITING
_UNDER_WAY = (TaskState.TASK_STATE_SUBMITTED, TaskState.TASK_STATE_WORKING)


# The SDK checks required fields value by value, also within the plan: 5 ms for 60 steps.
# `check_fields` omits the plan.
_send = unwrap(DefaultRequestHandler.on_message_send)
_send_stream = unwrap(DefaultRequestHandler.on_message_send_stream)


class Handler(DefaultRequestHandler):
    """Checks messages before a task is created; hides from tasks what the caller may not see."""

    def __init__(
        self,
        client_api: ClientApi,
        receipts: Receipts,
        tasks: Tasks,
        agent: AgentExecutor,
        *args: Any,
        **options: Any,
    ) -> None:
        super().__init__(agent, tasks, *args, **options)
        self._client_api = client_api
        self._receipts = receipts
        self._tasks = tasks

    async def _repeated(self, params: SendMessageRequest, context: ServerCallContext) -> str | None:
        """Check a message's form; return the task that it made, if it was received before."""
        check_fields(params)
        check(params.message)
        if caller_of(context).stops:
            return None
        found = await self._receipts.find(owner_of(context), params)
        return None if found is None else found.task

    @contextmanager
    def _receiving(self, params: SendMessageRequest, context: ServerCallContext) -> Generator[None]:
        """Receive a message for the first time."""
        new = context.state[NEW_TASK] = str(uuid4())
        if caller_of(context).stops:
            yield  # a stop is never taken for a repetition
            return
        with self._receipts.receiving(owner_of(context), params, params.message.task_id or new):
            yield

    async def _present(
        self, task_id: str, params: SendMessageRequest, context: ServerCallContext
    ) -> Message | Task:
        """Return the task of a repeated message as its first one would have been answered."""
        if not params.configuration.return_immediately:
            async with aclosing(self._events(task_id, context)) as events:
                async for event in events:
                    if _rests(event):
                        break
        wanted = GetTaskRequest(id=task_id)
        if params.configuration.HasField("history_length"):
            wanted.history_length = params.configuration.history_length
        found = await self.on_get_task(wanted, context)
        if found is None:
            raise TaskNotFoundError
        return found

    async def _events(self, task_id: str, context: ServerCallContext) -> AsyncGenerator[Any, None]:
        """Yield a task as it is and its further events, none if it has ended."""
        task: Any = await self.task_store.get(task_id, context)
        if task is None:
            raise TaskNotFoundError
        if _rests(task):
            yield task
            return
        stream = super().on_subscribe_to_task(SubscribeToTaskRequest(id=task_id), context)
        async with aclosing(stream) as events:
            async for event in events:
                yield event

    async def _check(self, params: SendMessageRequest, context: ServerCallContext) -> None:
        if params.message.task_id:
            task: Any = await self.task_store.get(params.message.task_id, context)
            if task is not None and task.status.state in _UNDER_WAY:
                raise UnsupportedOperationError(
                    "the task is running and takes no messages: cancel it, or wait until it ends"
                )
        elif self._tasks.is_full(owner_of(context)) and not caller_of(context).stops:
            raise UnsupportedOperationError(
                "too many of your tasks have not ended: answer or cancel some of them first",
                {"code": "queue_full"},
            )
        wants = params.configuration.HasField("task_push_notification_config")
        if wants and self._push_config_store is None:
            raise PushNotificationNotSupportedError

    def _mask(self, context: ServerCallContext, own: Iterable[Message] = ()) -> Mask:
        return Mask(self._client_api, caller_of(context).session, own)

    async def _visible(self, task: Task, context: ServerCallContext) -> Task:
        # The returned task may lack its history, and thus the request.
        turns = self._client_api.turns
        await turns.wait(caller_of(context).principal.identity)
        whole: Any = await self.task_store.get(task.id, context)
        del task.history[:-_HISTORY]
        with turns.spending():
            return self._mask(context, () if whole is None else _asked(whole)).task(task)

    async def on_get_task(self, params: GetTaskRequest, context: ServerCallContext) -> Task | None:
        """Handle `GetTask`."""
        task = await super().on_get_task(params, context)
        return None if task is None else await self._visible(task, context)

    async def on_list_tasks(
        self, params: ListTasksRequest, context: ServerCallContext
    ) -> ListTasksResponse:
        """Handle `ListTasks`."""
        found = await super().on_list_tasks(params, context)
        shown = ListTasksResponse()
        shown.CopyFrom(found)
        del shown.tasks[:]
        shown.tasks.extend([await self._visible(task, context) for task in found.tasks])
        return shown

    async def on_cancel_task(
        self, params: CancelTaskRequest, context: ServerCallContext
    ) -> Task | None:
        """Handle `CancelTask`."""
        task = await super().on_cancel_task(params, context)
        return None if task is None else await self._visible(task, context)

    async def on_message_send(
        self, params: SendMessageRequest, context: ServerCallContext
    ) -> Message | Task:
        """Handle `SendMessage`."""
        if (known := await self._repeated(params, context)) is not None:
            return await self._present(known, params, context)
        with self._receiving(params, context):
            await self._check(params, context)
            found = await _send(self, params, context)
        return self._mask(context, (params.message,)).event(found)

    async def on_message_send_stream(
        self, params: SendMessageRequest, context: ServerCallContext
    ) -> AsyncGenerator[Any, None]:
        """Handle `SendStreamingMessage`."""
        mask = self._mask(context, (params.message,))
        if (known := await self._repeated(params, context)) is not None:
            async with aclosing(_masked(self._events(known, context), mask)) as events:
                async for event in events:
                    yield event
            return
        with self._receiving(params, context):
            await self._check(params, context)
            stream = _send_stream(self, params, context)
            async with aclosing(_masked(stream, mask)) as events:
                async for event in events:
                    yield event

    async def on_subscribe_to_task(
        self, params: SubscribeToTaskRequest, context: ServerCallContext
    ) -> AsyncGenerator[Any, None]:
        """Handle `SubscribeToTask`."""
        stream = super().on_subscribe_to_task(params, context)
        async with aclosing(_masked(stream, self._mask(context))) as events:
            async for event in events:
                yield event


def _rests(event: Any) -> bool:
    """Return whether a task has ended or waits for its client."""
    return isinstance(event, (Task, TaskStatusUpdateEvent)) and event.status.state in _AT_REST


def _asked(task: Task) -> list[Message]:
    """Return the client's text, from a task that contains more."""
    return [message for message in task.history if message.role == Role.ROLE_USER]


async def _masked(stream: AsyncGenerator[Any, None], mask: Mask) -> AsyncGenerator[Any, None]:
    try:
        async for event in stream:
            if (masked := mask.event(event)) is not None:
                yield masked
    finally:
        await stream.aclose()
