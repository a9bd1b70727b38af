"""The SDK's request handler, with additional checks required by the specification."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import aclosing
from inspect import unwrap
from typing import Any

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
)
from a2a.utils.errors import PushNotificationNotSupportedError, UnsupportedOperationError

from rcp_a2a.callers import caller_of
from rcp_a2a.masking import Mask
from rcp_a2a.messages import check, check_fields
from rcp_kernel.client_api import ClientApi

__all__ = ["Handler"]


_HISTORY = 64  # latest messages of a task in a response: each is encoded in one turn
_UNDER_WAY = (TaskState.TASK_STATE_SUBMITTED, TaskState.TASK_STATE_WORKING)


# The SDK checks required fields value by value, also within the plan: 5 ms for 60 steps.
# `check_fields` omits the plan.
_send = unwrap(DefaultRequestHandler.on_message_send)
_send_stream = unwrap(DefaultRequestHandler.on_message_send_stream)


class Handler(DefaultRequestHandler):
    """Checks messages before a task is created; hides from tasks what the caller may not see."""

    def __init__(self, client_api: ClientApi, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._client_api = client_api

    async def _check(self, params: SendMessageRequest, context: ServerCallContext) -> None:
        check_fields(params)
        check(params.message)
        if params.message.task_id:
            task: Any = await self.task_store.get(params.message.task_id, context)
            if task is not None and task.status.state in _UNDER_WAY:
                raise UnsupportedOperationError(
                    "the task is running and takes no messages: cancel it, or wait until it ends"
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
        await self._check(params, context)
        return self._mask(context, (params.message,)).event(await _send(self, params, context))

    async def on_message_send_stream(
        self, params: SendMessageRequest, context: ServerCallContext
    ) -> AsyncGenerator[Any, None]:
        """Handle `SendStreamingMessage`."""
        await self._check(params, context)
        stream = _send_stream(self, params, context)
        async with aclosing(_masked(stream, self._mask(context, (params.message,)))) as events:
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
