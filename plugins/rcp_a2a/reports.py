"""What a client is told of its task: status updates, and the artifacts of its steps."""

from __future__ import annotations

from typing import Any

from a2a.server.events.event_queue import EventQueue
from a2a.server.tasks import TaskUpdater
from a2a.types.a2a_pb2 import Message, Part, Task, TaskState

from rcp_a2a.files import taken_out
from rcp_a2a.messages import VALUES, TaskRequest, count_values, data_part, stamp, text_part
from rcp_kernel.wire import Reply
from rcp_web.untrusted import TextMarker, robot_said

__all__ = ["STEP_ENDED", "Reports", "is_progress", "step_of"]

STEP_ENDED = frozenset(("completed", "recovered", "failed", "skipped", "cancelled"))
_PROGRESS = 256  # values of a step's progress that are included


class Reports:
    """The reports on one task."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._states: dict[str, str] = {}
        self._room = VALUES
        """Values that the task's artifacts may still contain as data."""
        self._updater: TaskUpdater
        self.plan: TaskRequest

    @property
    def has_steps(self) -> bool:
        """Whether a step was reported."""
        return bool(self._states)

    def listen(self, queue: EventQueue) -> None:
        """Send to a queue from now on."""
        self._updater = TaskUpdater(queue, self._task.id, self._task.context_id)

    async def working(self, facts: dict[str, Any]) -> None:
        """Report that the plan has started."""
        metadata = {"command": facts["command"]} if "command" in facts else None
        message = self._message("The plan was checked and starts.")
        await self._status(TaskState.TASK_STATE_WORKING, message, metadata=metadata)

    async def step(self, facts: dict[str, Any]) -> None:
        """Report the start, the progress or the end of a step."""
        step: dict[str, Any] = facts["body"]
        id_, state = str(step.get("step")), str(step.get("state"))
        data = {key: step[key] for key in ("step", "do", "path", "state") if key in step}
        if state in STEP_ENDED:
            await self._step_artifact(id_, step)
            data["artifact"] = f"step-{id_}"
        if self._states.get(id_) == state:
            # Progress goes into the metadata only, where the newest replaces the previous.
            if count_values(step, _PROGRESS) > _PROGRESS:
                del step["feedback"]
            metadata = {"step": step, "progress": facts.get("progress")}
            await self._status(TaskState.TASK_STATE_WORKING, metadata=metadata)
            return
        self._states[id_] = state
        await self._status(TaskState.TASK_STATE_WORKING, self._message(_line(id_, step), data))

    async def _step_artifact(self, id_: str, step: dict[str, Any]) -> None:
        rest, files = taken_out(step, f"step-{id_}") if self.plan.images else (step, [])
        await self._updater.add_artifact(
            [self._data(rest), *files],
            artifact_id=f"step-{id_}",
            name=step.get("path") or step.get("do"),
            metadata={"step": id_, "state": step.get("state")},
            last_chunk=True,
        )

    async def artifact(self, name: str, value: Any) -> None:
        """Report the outcome of the whole plan."""
        await self._updater.add_artifact([self._data(value)], name, name, last_chunk=True)

    async def state(self, state: TaskState, text: str, data: Any = None) -> None:
        """Report a state with its reason."""
        await self._status(state, self._message(text, data))

    async def _status(self, state: TaskState, message: Message | None = None, **more: Any) -> None:
        await self._updater.update_status(state, message, stamp(), **more)

    def _data(self, value: Any) -> Part:
        """Build a data part, or a text part with JSON if the task would have too many values."""
        count = count_values(value, self._room)
        if count > self._room:
            return text_part(value)
        self._room -= count
        return data_part(value, words=self.plan.words)

    def _message(self, text: str, data: Any = None) -> Message:
        parts = [Part(text=text)]
        if data is not None:
            parts.append(data_part(data, words=self.plan.words))
        return self._updater.new_agent_message(parts)


def is_progress(reply: Reply) -> bool:
    """Return whether a reply contains progress only."""
    return reply.status == "in_progress" and _state(reply) not in STEP_ENDED


def step_of(reply: Reply) -> Any:
    """Return what a reply is about: a step and its state."""
    return getattr(reply.body, "step", None), _state(reply)


def _state(reply: Reply) -> Any:
    return getattr(reply.body, "state", None)


def _line(id_: str, step: dict[str, Any]) -> str:
    what = " ".join(str(step[key]) for key in ("do", "path") if step.get(key))
    error: dict[str, Any] = step.get("error") or {}
    why = step.get("message") or error.get("message")
    if why and robot_said(error):
        why = TextMarker().text(str(why))
    ended = step.get("state") == "completed"  # the text for this code is less specific
    return f"Step {id_}, {what}: {step.get('state')}" + (f", {why}" if why and not ended else "")
