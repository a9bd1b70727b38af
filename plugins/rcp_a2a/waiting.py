"""Tasks that wait for input, as they are kept over a restart of the gateway."""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec
import structlog

from rcp_a2a.messages import TaskRequest
from rcp_a2a.questions import Question
from rcp_gateway.api import PluginStore

__all__ = ["Pending", "WaitingTasks"]

log = structlog.get_logger("rcp.a2a")


class Pending(NamedTuple):
    """What a task waits for."""

    plan: TaskRequest
    question: Question


class WaitingTasks:
    """The open questions of all tasks."""

    def __init__(self, store: PluginStore) -> None:
        self._store = store
        self._earlier: dict[str, Pending] = {}

    def restore(self) -> None:
        """Load the questions of earlier runs."""
        for task_id, row in self._store.load().items():
            try:
                plan: Any = msgspec.convert(row["plan"], TaskRequest)
                question: Any = msgspec.convert(row["question"], Question)
            except (KeyError, TypeError, msgspec.ValidationError) as error:
                log.warning("question_unreadable", task=task_id, error=str(error))
                self.forget(task_id)
                continue
            self._earlier[task_id] = Pending(plan, question)

    def has(self, task_id: str) -> bool:
        """Return whether a task of an earlier run waits for its client."""
        return task_id in self._earlier

    def take(self, task_id: str) -> Pending | None:
        """Return the question of a task of an earlier run, once."""
        return self._earlier.pop(task_id, None)

    def keep(self, task_id: str, plan: TaskRequest, question: Question) -> None:
        """Keep a question until it is answered."""
        row = {"plan": msgspec.to_builtins(plan), "question": msgspec.to_builtins(question)}
        self._store.put(task_id, row)

    def forget(self, task_id: str) -> None:
        """Remove a question, if there is one."""
        self._earlier.pop(task_id, None)
        self._store.put(task_id, None)
