"""Tasks, in memory and in the gateway's store, with their owners and their lifetime."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import structlog
from a2a.server.context import ServerCallContext
from a2a.server.tasks import InMemoryTaskStore
from a2a.types.a2a_pb2 import (
    ListTasksRequest,
    ListTasksResponse,
    Message,
    Part,
    Role,
    Task,
    TaskState,
)
from google.protobuf.message import DecodeError

from rcp_a2a.callers import owner_of
from rcp_a2a.config import A2aConfig
from rcp_a2a.messages import stamp
from rcp_gateway.api import PluginStore
from rcp_kernel.clock import now

__all__ = ["ENDED", "WAITING", "Tasks"]

log = structlog.get_logger("rcp.a2a")
ENDED = frozenset(
    (
        TaskState.TASK_STATE_COMPLETED,
        TaskState.TASK_STATE_FAILED,
        TaskState.TASK_STATE_CANCELED,
        TaskState.TASK_STATE_REJECTED,
    )
)
WAITING = frozenset((TaskState.TASK_STATE_INPUT_REQUIRED, TaskState.TASK_STATE_AUTH_REQUIRED))
_PAGE = 98_304  # bytes of tasks per page, unless a single one is larger
_S = 1_000_000_000  # ns
_NO_ANSWER = "nobody answered in time, since the gateway was restarted"
_CUT_OFF = "the gateway was restarted during the task; it commanded the robot to halt"


class Tasks(InMemoryTaskStore):
    """The SDK's task store; every task is also written to the gateway's store."""

    def __init__(self, store: PluginStore, config: A2aConfig) -> None:
        super().__init__(owner_of)
        self._kept_rows = store
        self._most = config.tasks
        self._size = config.tasks_size
        self._retention = int(config.retention * _S)
        self._sizes: dict[str, dict[str, int]] = {}
        """Size of each task in bytes, by owner: computing all for every save takes too long."""
        self.forgotten: list[Callable[[str], None]] = []
        """Called with the id of each task that is dropped."""
        self.saved: list[Callable[[Task], None]] = []
        """Called with each task that was saved."""

    @property
    def _owners(self) -> dict[str, dict[str, Task]]:
        return self._impl.tasks

    def restore(self, waits: Callable[[str], bool]) -> None:
        """Load the tasks of earlier runs; those that were running have failed.

        `waits` says whether a task still waits for its client, with a question that was kept.
        """
        for key, row in self._kept_rows.load().items():
            if (task := _read(key, row)) is None:
                self._kept_rows.put(key, None)
                continue
            owner = row["owner"]
            self._owners.setdefault(owner, {})[task.id] = task
            self._weigh(owner, task)
            if task.status.state not in ENDED | (WAITING if waits(task.id) else frozenset()):
                _cut_off(task, _CUT_OFF)
                self._keep(owner, task)
        for owner in list(self._owners):
            self._make_room(owner)

    def expire(self, waits: Callable[[str], bool]) -> None:
        """End the tasks of earlier runs that have waited for their client for too long."""
        for owner, known in self._owners.items():
            for task in known.values():
                if task.status.state in WAITING and waits(task.id):
                    _cut_off(task, _NO_ANSWER)
                    self._keep(owner, task)
                    for callback in self.saved:
                        callback(task)

    def has(self, owner: str, task_id: str) -> bool:
        """Return whether an owner has a task."""
        return task_id in self._owners.get(owner, {})

    def is_full(self, owner: str) -> bool:
        """Return whether an owner has as many tasks that have not ended as may be kept."""
        known = self._owners.get(owner, {})
        if len(known) < self._most:
            return False
        return sum(task.status.state not in ENDED for task in known.values()) >= self._most

    async def save(self, task: Task, context: ServerCallContext) -> None:
        """Save a task in its present state."""
        owner = owner_of(context)
        fresh = not self.has(owner, task.id)
        await super().save(task, context)
        self._keep(owner, task)
        for callback in self.saved:
            callback(task)
        if fresh or task.status.state in ENDED:
            self._make_room(owner)

    async def list(self, params: ListTasksRequest, context: ServerCallContext) -> ListTasksResponse:
        """List tasks; fewer than the page size if they would be too large together."""
        page = await self._impl.list(params, context)
        sizes, length = self._sizes.get(owner_of(context), {}), 0
        for number, task in enumerate(page.tasks):
            length += sizes.get(task.id, 0)
            if length > _PAGE and number:
                shorter = ListTasksRequest()
                shorter.CopyFrom(params)
                shorter.page_size = number
                return await super().list(shorter, context)
        return page

    async def delete(self, task_id: str, context: ServerCallContext) -> None:
        """Delete a task."""
        await super().delete(task_id, context)
        self._forget(owner_of(context), task_id)

    def _weigh(self, owner: str, task: Task) -> None:
        self._sizes.setdefault(owner, {})[task.id] = task.ByteSize()

    def _keep(self, owner: str, task: Task) -> None:
        self._weigh(owner, task)
        if self._kept_rows.keeps:
            self._kept_rows.put(task.id, {"owner": owner, "task": task.SerializeToString()})

    def _forget(self, owner: str, task_id: str) -> None:
        self._sizes.get(owner, {}).pop(task_id, None)
        self._kept_rows.put(task_id, None)
        for callback in self.forgotten:
            callback(task_id)

    def _make_room(self, owner: str) -> None:
        """Drop tasks that ended too long ago, and the oldest beyond the limits."""
        known = self._owners[owner]
        ended = [task for task in known.values() if task.status.state in ENDED]
        ended.sort(key=_when)
        latest = now() - self._retention
        surplus = len(known) - self._most
        beyond = sum(self._sizes.get(owner, {}).values()) - self._size
        for place, task in enumerate(ended):
            if place >= surplus and beyond <= 0 and _when(task) >= latest:
                break
            beyond -= self._sizes[owner][task.id]
            del known[task.id]
            self._forget(owner, task.id)


def _when(task: Task) -> int:
    return task.status.timestamp.ToNanoseconds()


def _read(key: str, row: Any) -> Task | None:
    try:
        return Task.FromString(row["task"])
    except (DecodeError, KeyError, TypeError) as error:
        log.warning("task_unreadable", task=key, error=str(error))
        return None


def _cut_off(task: Task, why: str) -> None:
    task.status.state = TaskState.TASK_STATE_FAILED
    task.status.timestamp.FromJsonString(stamp())
    task.status.message.CopyFrom(
        Message(
            message_id=f"{task.id}.cut-off",
            role=Role.ROLE_AGENT,
            task_id=task.id,
            context_id=task.context_id,
            parts=[Part(text=why)],
        )
    )
