"""Receipts of messages: a repeated message returns the task that it made, and runs nothing again."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

import msgspec
import structlog
from a2a.types.a2a_pb2 import SendMessageRequest, Task
from a2a.utils.errors import InvalidParamsError, UnsupportedOperationError

from rcp_gateway.api import PluginStore
from rcp_protocol.timeouts import timeout

__all__ = ["Receipt", "Receipts", "key_of"]

log = structlog.get_logger("rcp.a2a")
_PATIENCE = 10.0  # s that a repetition waits until the first message has a task


class Receipt(msgspec.Struct, eq=False):
    """A message that was received."""

    key: str
    owner: str
    message: str
    """The message's id."""
    digest: bytes
    task: str
    taken: asyncio.Event = msgspec.field(default_factory=asyncio.Event)
    """Set when the task has the message, or the message was refused."""


class Receipts:
    """The receipts of all tasks; each is kept as long as its task."""

    def __init__(self, store: PluginStore) -> None:
        self._store = store
        self._known: dict[str, Receipt] = {}
        self._by_task: dict[str, list[Receipt]] = {}

    def restore(self, is_known: Callable[[str, str], bool]) -> None:
        """Load the receipts of earlier runs; `is_known` says whether an owner has a task."""
        for key, row in self._store.load().items():
            try:
                receipt = Receipt(key, row["owner"], row["message"], row["digest"], row["task"])
            except (KeyError, TypeError) as error:
                log.warning("receipt_unreadable", receipt=key, error=str(error))
                self._store.put(key, None)
                continue
            if not is_known(receipt.owner, receipt.task):
                # Its task was never kept; the gateway's idempotency key knows what came of it.
                self._store.put(key, None)
                continue
            receipt.taken.set()
            self._add(receipt)

    async def find(self, owner: str, request: SendMessageRequest) -> Receipt | None:
        """Return the receipt of a message that was received before, once it has its task.

        :raises InvalidParamsError: the id was used for a message with other content.
        :raises UnsupportedOperationError: the first message is still being received.
        """
        key = key_of(owner, request.message.message_id)
        while (receipt := self._known.get(key)) is not None:
            if receipt.digest != _digest(request):
                raise InvalidParamsError(
                    "this messageId was used for a message with different content: give each "
                    "message an id of its own, and repeat one only unchanged",
                    {"code": "duplicate_request", "taskId": receipt.task},
                )
            if receipt.taken.is_set():
                return receipt
            try:
                async with timeout(_PATIENCE):
                    await receipt.taken.wait()
            except TimeoutError:
                raise UnsupportedOperationError(
                    "this message is still being received: send it again unchanged"
                ) from None
        return None

    @contextmanager
    def receiving(self, owner: str, request: SendMessageRequest, task_id: str) -> Generator[None]:
        """Receive a message; one that no task took in the end was not received."""
        message = request.message.message_id
        receipt = Receipt(key_of(owner, message), owner, message, _digest(request), task_id)
        self._add(receipt)
        # Before the gateway's own record of the command, so that neither is kept without this one.
        row = msgspec.structs.asdict(receipt)
        self._store.put(receipt.key, {key: row[key] for key in _KEPT})
        try:
            yield
        finally:
            # A task that takes it later, of a client that left, has the same idempotency key.
            if not receipt.taken.is_set():
                self._drop(receipt)

    def saved(self, task: Task) -> None:
        """Note which messages a task has."""
        for receipt in self._by_task.get(task.id, ()):
            if not receipt.taken.is_set() and any(
                message.message_id == receipt.message for message in task.history
            ):
                receipt.taken.set()

    def forget(self, task_id: str) -> None:
        """Remove the receipts of a deleted task."""
        for receipt in self._by_task.get(task_id, [])[:]:
            self._drop(receipt)

    def _add(self, receipt: Receipt) -> None:
        self._known[receipt.key] = receipt
        self._by_task.setdefault(receipt.task, []).append(receipt)

    def _drop(self, receipt: Receipt) -> None:
        receipt.taken.set()
        if self._known.get(receipt.key) is not receipt:
            return
        del self._known[receipt.key]
        self._store.put(receipt.key, None)
        of_task = self._by_task[receipt.task]
        of_task.remove(receipt)
        if not of_task:
            del self._by_task[receipt.task]


_KEPT = ("owner", "message", "digest", "task")


def key_of(owner: str, message_id: str) -> str:
    """Return the key of an owner's message; also the idempotency key of its command."""
    digest = hashlib.sha256(f"{len(owner)}:{owner}:{message_id}".encode()).hexdigest()
    return f"a2a-{digest}"


def _digest(request: SendMessageRequest) -> bytes:
    """Return the digest of a message's content; how its answer is wanted is not part of it."""
    parts: tuple[Any, ...] = (request.message, request.metadata)
    found = hashlib.sha256()
    for part in parts:
        data = part.SerializeToString(deterministic=True)
        found.update(len(data).to_bytes(8, "big") + data)
    return found.digest()
