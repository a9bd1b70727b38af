"""The SDK's handler of requests, with what the specification asks for beyond it."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from typing import Any

from a2a.server.context import ServerCallContext
from a2a.server.request_handlers import DefaultRequestHandler
from a2a.types.a2a_pb2 import Message, SendMessageRequest, Task, TaskState
from a2a.utils.errors import PushNotificationNotSupportedError, UnsupportedOperationError

from rcp_a2a.messages import check

__all__ = ["Handler"]


_UNDER_WAY = (TaskState.TASK_STATE_SUBMITTED, TaskState.TASK_STATE_WORKING)


class Handler(DefaultRequestHandler):
    """Checks the form of messages before a task is made of them."""

    async def _check(self, params: SendMessageRequest, context: ServerCallContext) -> None:
        check(params.message)
        if params.message.task_id:
            task: Any = await self.task_store.get(params.message.task_id, context)
            if task is not None and task.status.state in _UNDER_WAY:
                raise UnsupportedOperationError(
                    "the task is under way and takes no messages: cancel it, or wait until it ends"
                )
        wants = params.configuration.HasField("task_push_notification_config")
        if wants and self._push_config_store is None:
            raise PushNotificationNotSupportedError

    async def on_message_send(
        self, params: SendMessageRequest, context: ServerCallContext
    ) -> Message | Task:
        """Handle `SendMessage`."""
        await self._check(params, context)
        return await super().on_message_send(params, context)

    async def on_message_send_stream(
        self, params: SendMessageRequest, context: ServerCallContext
    ) -> AsyncGenerator[Any, None]:
        """Handle `SendStreamingMessage`."""
        await self._check(params, context)
        stream = super().on_message_send_stream(params, context)
        try:
            async for event in stream:
                yield event
        finally:
            await stream.aclose()
