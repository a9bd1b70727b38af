"""The SDK's handler of requests, with what the specification asks for beyond it."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from typing import Any

from a2a.server.context import ServerCallContext
from a2a.server.request_handlers import DefaultRequestHandler
from a2a.types.a2a_pb2 import Message, SendMessageRequest, Task
from a2a.utils.errors import PushNotificationNotSupportedError

from rcp_a2a.messages import check

__all__ = ["Handler"]


class Handler(DefaultRequestHandler):
    """Checks the form of messages before a task is made of them."""

    def _check(self, params: SendMessageRequest) -> None:
        check(params.message)
        wants = params.configuration.HasField("task_push_notification_config")
        if wants and self._push_config_store is None:
            raise PushNotificationNotSupportedError

    async def on_message_send(
        self, params: SendMessageRequest, context: ServerCallContext
    ) -> Message | Task:
        """Handle `SendMessage`."""
        self._check(params)
        return await super().on_message_send(params, context)

    async def on_message_send_stream(
        self, params: SendMessageRequest, context: ServerCallContext
    ) -> AsyncGenerator[Any, None]:
        """Handle `SendStreamingMessage`."""
        self._check(params)
        stream = super().on_message_send_stream(params, context)
        try:
            async for event in stream:
                yield event
        finally:
            await stream.aclose()
