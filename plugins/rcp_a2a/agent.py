"""The agent: executes the plan of a message as a task, and cancels it."""

from __future__ import annotations

from typing import Any

import structlog
from a2a.server.agent_execution import AgentExecutor, RequestContext
from a2a.server.events.event_queue import EventQueue
from a2a.types.a2a_pb2 import SendMessageRequest, Task, TaskState, TaskStatus
from a2a.utils.errors import TaskNotCancelableError

from rcp_a2a.callers import Caller, caller_of, owner_of
from rcp_a2a.messages import parse_message, stamp
from rcp_a2a.receipts import key_of
from rcp_a2a.run import Run
from rcp_a2a.waiting import WaitingTasks
from rcp_gateway.client_api import ClientApi

__all__ = ["Agent"]

log = structlog.get_logger("rcp.a2a")


class Agent(AgentExecutor):
    """Executes messages."""

    def __init__(self, client_api: ClientApi, patience: float, waiting: WaitingTasks) -> None:
        self._client_api = client_api
        self._patience = patience
        self._waiting = waiting
        self._runs: dict[str, Run] = {}

    async def execute(self, context: RequestContext, event_queue: EventQueue) -> None:
        """Start or continue the plan of a message, until its end or the next question."""
        caller = caller_of(context.call_context)
        request = _request(context)
        wanted = parse_message(request)
        key = key_of(owner_of(context.call_context), request.message.message_id)
        task = context.current_task
        if task is None:
            task = _begun(context)
            await event_queue.enqueue_event(task)
            run = self._runs[task.id] = self._made(task)
            run.listen(event_queue)
            run.start(caller, wanted, key)
        else:
            run = self._run(task, caller)
            if run is None or run.question is None:
                return  # the task ended, or went on, before this message arrived
            run.listen(event_queue)
            if (text := run.answer(caller, wanted, key)) is not None:
                await run.ask_again(text)
                return
        try:
            await run.attend()
        finally:
            if run.question is None:
                self._forget(task.id)
                run.ended.set()  # in any case: a cancellation waits for it

    def _made(self, task: Task) -> Run:
        return Run(self._client_api, task, self._patience, self._forget, self._waiting)

    def _run(self, task: Task, caller: Caller) -> Run | None:
        """Return the run of a task; one that waited in an earlier run of the gateway goes on."""
        run = self._runs.get(task.id)
        if run is None and (pending := self._waiting.take(task.id)) is not None:
            run = self._runs[task.id] = self._made(task)
            run.resume(caller, pending)
        return run

    def _forget(self, task_id: str) -> None:
        self._runs.pop(task_id, None)

    async def cancel(self, context: RequestContext, event_queue: EventQueue) -> None:
        """Cancel the running steps of a task's plan."""
        caller, task = caller_of(context.call_context), context.current_task
        known = context.task_id in self._runs
        run = None if task is None else self._run(task, caller)
        if run is None:
            raise TaskNotCancelableError
        if not known:
            run.listen(event_queue)
        await run.cancel(caller)


def _request(context: RequestContext) -> SendMessageRequest:
    request: Any = context._params  # noqa: SLF001 - the SDK exposes its metadata, but not the message
    return request


def _begun(context: RequestContext) -> Task:
    status = TaskStatus(state=TaskState.TASK_STATE_SUBMITTED)
    status.timestamp.FromJsonString(stamp())
    return Task(
        id=context.task_id,
        context_id=context.context_id,
        status=status,
        history=[] if context.message is None else [context.message],
    )
