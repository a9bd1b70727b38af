"""One task as it runs: the replies of its plan's command, told as status updates and artifacts."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Any

import msgspec
import structlog
from a2a.server.events.event_queue import EventQueue
from a2a.server.tasks import TaskUpdater
from a2a.types.a2a_pb2 import Part, Task, TaskState
from msgspec import Raw

from rcp_a2a.callers import Caller
from rcp_a2a.messages import Asked, data_part, told
from rcp_kernel.door import Door
from rcp_kernel.wire import Reply, Request

__all__ = ["PLANS", "Run"]

log = structlog.get_logger("rcp.a2a")
PLANS = "/system/plans"
_PACE = 0.2  # s between two updates that only tell of progress
_STEP_ENDED = frozenset(("completed", "recovered", "failed", "skipped", "cancelled"))
_FINAL = {
    "completed": TaskState.TASK_STATE_COMPLETED,
    "failed": TaskState.TASK_STATE_FAILED,
    "rejected": TaskState.TASK_STATE_REJECTED,
    "cancelled": TaskState.TASK_STATE_CANCELED,
}


class Run:
    """A plan under way."""

    def __init__(self, door: Door, caller: Caller, task: Task) -> None:
        self._door = door
        self._caller = caller
        self.task = task
        self.command: str | None = None
        self.cancelled = False
        """Whether the client cancelled the task."""
        self.ended = asyncio.Event()
        self._replies: deque[Reply] = deque()
        self._arrived = asyncio.Event()
        self._states: dict[str, str] = {}
        self._updater: TaskUpdater

    # -- the gateway's side --------------------------------------------------------------------

    def start(self, asked: Asked) -> None:
        """Have the gateway check the plan and begin it."""
        request = Request(
            type="execute",
            path=PLANS,
            id=f"a2a-{self.task.id}",
            dry_run=asked.dry_run,
            deadline=asked.deadline,
            body=Raw(msgspec.json.encode(asked.body)),
        )
        self._door.submit(self._caller.session, request, self._take)

    def _take(self, reply: Reply) -> None:
        self.command = reply.command or self.command
        last = self._replies[-1] if self._replies else None
        if last is not None and _passing(last) and _passing(reply) and _step(last) == _step(reply):
            self._replies.pop()  # the newest progress wins for a task that is behind
        self._replies.append(reply)
        self._arrived.set()

    async def cancel(self, caller: Caller) -> None:
        """Have the plan's running steps cancelled; returns once the robots have confirmed it."""
        self.cancelled = True
        if self.command is not None:
            request = Request(type="cancel", path=PLANS, command=self.command)
            await self._door.ask(caller.session, request)
        await self.ended.wait()

    # -- the client's side ---------------------------------------------------------------------

    async def attend(self, queue: EventQueue) -> None:
        """Tell what happens until the plan has ended."""
        self._updater = TaskUpdater(queue, self.task.id, self.task.context_id)
        final = False
        while not final:
            await self._arrived.wait()
            self._arrived.clear()
            passing = False
            while self._replies:
                reply = self._replies.popleft()
                await self._tell(reply)
                final = final or reply.final
                passing = _passing(reply)
            if passing and not final:
                await asyncio.sleep(_PACE)

    async def _tell(self, reply: Reply) -> None:
        facts = told(reply)
        if reply.final:
            await self._conclude(facts)
        elif reply.status == "in_progress" and isinstance(facts.get("body"), dict):
            await self._tell_step(facts)
        else:
            await self._working(reply.message or "The plan was checked and begins.", facts)

    async def _working(self, text: str, facts: dict[str, Any]) -> None:
        metadata = {"command": facts["command"]} if "command" in facts else None
        await self._updater.update_status(
            TaskState.TASK_STATE_WORKING, self._message(text), metadata=metadata
        )

    async def _tell_step(self, facts: dict[str, Any]) -> None:
        step: dict[str, Any] = facts["body"]
        id_, state = str(step.get("step")), str(step.get("state"))
        if state in _STEP_ENDED:
            await self._artifact(id_, step)
        if self._states.get(id_) == state:
            # Progress alone goes into the metadata, where the newest replaces the one before.
            metadata = {"step": step, "progress": facts.get("progress")}
            await self._updater.update_status(TaskState.TASK_STATE_WORKING, metadata=metadata)
            return
        self._states[id_] = state
        await self._updater.update_status(
            TaskState.TASK_STATE_WORKING, self._message(_line(id_, step), step)
        )

    async def _artifact(self, id_: str, step: dict[str, Any]) -> None:
        await self._updater.add_artifact(
            [data_part(step)],
            artifact_id=f"step-{id_}",
            name=step.get("path") or step.get("do"),
            metadata={"step": id_, "state": step.get("state")},
            last_chunk=True,
        )

    async def _conclude(self, facts: dict[str, Any]) -> None:
        status: str = facts["status"]
        state = _FINAL[status]
        text = facts.get("message") or f"The plan is {status}."
        if status == "cancelled" and not self.cancelled and self._door.closing:
            state, text = TaskState.TASK_STATE_FAILED, "The gateway was stopped in mid-task."
        if facts.get("dry_run"):
            parts = [data_part(facts.get("body"))]
            await self._updater.add_artifact(parts, "check", "check", last_chunk=True)
        elif status == "completed" and not self._states and "body" in facts:
            parts = [data_part(facts["body"])]
            await self._updater.add_artifact(parts, "result", "result", last_chunk=True)
        message = self._message(text, facts.get("error"))
        await self._updater.update_status(state, message)
        self.ended.set()

    def _message(self, text: str, data: Any = None) -> Any:
        parts = [Part(text=text)] + ([] if data is None else [data_part(data)])
        return self._updater.new_agent_message(parts)


def _passing(reply: Reply) -> bool:
    """Tell whether a reply is of progress only."""
    return reply.status == "in_progress" and _state(reply) not in _STEP_ENDED


def _state(reply: Reply) -> Any:
    return getattr(reply.body, "state", None)


def _step(reply: Reply) -> Any:
    return getattr(reply.body, "step", None), _state(reply)


def _line(id_: str, step: dict[str, Any]) -> str:
    what = " ".join(str(step[key]) for key in ("do", "path") if step.get(key))
    why = step.get("message") or (step.get("error") or {}).get("message")
    return f"Step {id_}, {what}: {step.get('state')}" + (f" - {why}" if why else "") + "."
