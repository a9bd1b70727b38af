"""Hides from a task what its caller may no longer see."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from a2a.types.a2a_pb2 import (
    Artifact,
    Message,
    Role,
    Task,
    TaskArtifactUpdateEvent,
    TaskStatus,
    TaskStatusUpdateEvent,
)
from google.protobuf.json_format import MessageToDict

from rcp_gateway.api import TOUCHES_EVERYTHING, Session, names_in
from rcp_gateway.client_api import ClientApi

__all__ = ["Mask"]


class Mask:
    """Hides what one caller may not see; paths that the caller named itself are not secret."""

    def __init__(
        self, client_api: ClientApi, session: Session, own: Iterable[Message] = ()
    ) -> None:
        self._client_api = client_api
        self._session = session
        self._own: set[str] = set()
        for message in own:
            self._learn(message)

    def task(self, task: Task) -> Task:
        """Return a task as the caller may see it."""
        for message in task.history:
            self._learn(message)
        shown = Task()
        shown.CopyFrom(task)
        del shown.artifacts[:], shown.history[:]
        shown.artifacts.extend(a for a in task.artifacts if not self._hides_artifact(a))
        shown.history.extend(m for m in task.history if not self._hides_message(m))
        self._cover(shown)
        self._cover_status(shown.status)
        return shown

    def event(self, event: Any) -> Any:
        """Return an event as the caller may see it; None if it must not be sent at all."""
        if isinstance(event, Task):
            return self.task(event)
        if isinstance(event, TaskArtifactUpdateEvent):
            return None if self._hides_artifact(event.artifact) else event
        if isinstance(event, TaskStatusUpdateEvent):
            shown = TaskStatusUpdateEvent()
            shown.CopyFrom(event)
            self._cover(shown)
            self._cover_status(shown.status)
            return shown
        return event

    def _cover(self, shown: Task | TaskStatusUpdateEvent) -> None:
        if shown.HasField("metadata") and self._hides(_names(shown.metadata)):
            shown.ClearField("metadata")

    def _cover_status(self, status: TaskStatus) -> None:
        if status.HasField("message") and self._hides_message(status.message):
            status.ClearField("message")

    def _hides_artifact(self, artifact: Artifact) -> bool:
        names = _names(artifact)
        # Long values are judged by their path only.
        return self._hides(names_in(artifact.name) if TOUCHES_EVERYTHING in names else names)

    def _hides_message(self, message: Message) -> bool:
        if message.role == Role.ROLE_USER:
            return False
        return self._hides({name for name in _names(message) if _short(name) not in self._own})

    def _hides(self, names: Iterable[str]) -> bool:
        return self._client_api.hides(self._session, names)

    def _learn(self, message: Message) -> None:
        if message.role == Role.ROLE_USER:
            self._own |= {_short(name) for name in _names(message)}


def _names(part: Any) -> frozenset[str]:
    return names_in(MessageToDict(part))


def _short(name: str) -> str:
    """Return a path without its tenant, which a caller may omit."""
    return name.split("/", 3)[-1] if name.startswith("/tenant/") else name.replace(".", "/")
