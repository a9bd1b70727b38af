"""Notifications: task updates are posted to the addresses that the owner has registered."""

from __future__ import annotations

import asyncio
import ssl
from collections import deque
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

import httpx
import msgspec
import structlog
from a2a.server.context import ServerCallContext
from a2a.server.tasks import InMemoryPushNotificationConfigStore, PushNotificationSender
from a2a.server.tasks.push_notification_sender import PushNotificationEvent
from a2a.types.a2a_pb2 import TaskPushNotificationConfig
from a2a.utils.constants import A2A_JSON_MEDIA_TYPE
from a2a.utils.errors import InvalidParamsError
from a2a.utils.proto_utils import to_stream_response
from google.protobuf.json_format import MessageToDict
from google.protobuf.message import DecodeError

from rcp_a2a.addresses import Addresses, Unfit, Unknown
from rcp_a2a.callers import owner_of
from rcp_a2a.config import PushConfig
from rcp_gateway.api import PluginStore
from rcp_kernel.errors import ConfigError

__all__ = ["Notifier", "Subscribers"]

log = structlog.get_logger("rcp.a2a")
_LONGEST_WAIT = 60.0  # s between attempts
_TEXT = 1024  # characters of a token or of credentials


class Subscribers(InMemoryPushNotificationConfigStore):
    """The addresses of each task, kept as long as the task."""

    def __init__(self, store: PluginStore, most: int) -> None:
        super().__init__(owner_of)
        self._store = store
        self._most = most

    def restore(self) -> None:
        """Load the addresses of earlier runs."""
        for task_id, row in self._store.load().items():
            try:
                configs = [TaskPushNotificationConfig.FromString(one) for one in row["configs"]]
            except (DecodeError, KeyError, TypeError):
                self._store.put(task_id, None)
                continue
            self._push_notification_infos.setdefault(row["owner"], {})[task_id] = configs

    async def set_info(
        self,
        task_id: str,
        notification_config: TaskPushNotificationConfig,
        context: ServerCallContext,
    ) -> TaskPushNotificationConfig:
        """Add an address to a task, or replace the one with the same id.

        :raises InvalidParamsError: it is invalid, or there are too many.
        """
        _check(notification_config)
        known = await self.get_info(task_id, context)
        wanted = notification_config.id or task_id
        if len(known) >= self._most and all(one.id != wanted for one in known):
            raise InvalidParamsError(f"a task has at most {self._most} push configurations")
        stored = await super().set_info(task_id, notification_config, context)
        self._keep(task_id, owner_of(context))
        return stored

    async def delete_info(
        self, task_id: str, context: ServerCallContext, config_id: str | None = None
    ) -> None:
        """Remove an address from a task."""
        await super().delete_info(task_id, context, config_id)
        self._keep(task_id, owner_of(context))

    def forget(self, task_id: str) -> None:
        """Remove the addresses of a deleted task."""
        for infos in self._push_notification_infos.values():
            infos.pop(task_id, None)
        self._store.put(task_id, None)

    def _keep(self, task_id: str, owner: str) -> None:
        if not self._store.keeps:
            return
        configs = self._push_notification_infos.get(owner, {}).get(task_id, [])
        row = {"owner": owner, "configs": [one.SerializeToString() for one in configs]}
        self._store.put(task_id, row if configs else None)


def _check(config: TaskPushNotificationConfig) -> None:
    given = (config.token, config.authentication.scheme, config.authentication.credentials)
    for text in given:
        if len(text) > _TEXT or not text.isascii() or any(ord(c) < 32 for c in text):
            raise InvalidParamsError(
                "a token or credential contains characters that are not allowed in a header"
            )


def _trusted(ca: str | None) -> ssl.SSLContext:
    context = httpx.create_ssl_context(trust_env=False)
    if ca is not None:
        try:
            context.load_verify_locations(ca)
        except OSError as error:
            raise ConfigError(
                f"[plugins.a2a.push] ca cannot be read ({error}): set it to a PEM file of "
                "certificates"
            ) from None
    return context


class _Waiting(msgspec.Struct, frozen=True):
    config: TaskPushNotificationConfig
    body: bytes


class Notifier(PushNotificationSender):
    """Posts in order per address, in the background; a full queue drops its oldest."""

    def __init__(self, config: PushConfig, addresses: Addresses, subscribers: Subscribers) -> None:
        """Load the CAs.

        :raises ConfigError: they cannot be read.
        """
        self._config = config
        self._addresses = addresses
        self._subscribers = subscribers
        self._waiting: dict[tuple[str, str], deque[_Waiting]] = {}
        self._count = 0
        self._workers: dict[tuple[str, str], asyncio.Task[None]] = {}
        self._client: httpx.AsyncClient | None = None
        self._trusted = _trusted(config.ca)

    @asynccontextmanager
    async def running(self) -> AsyncGenerator[None]:
        """Post notifications while entered."""
        client = httpx.AsyncClient(
            timeout=self._config.timeout,
            follow_redirects=False,
            trust_env=False,
            verify=self._trusted,
        )
        async with client:
            self._client = client
            try:
                yield
            finally:
                self._client = None
                for worker in self._workers.values():
                    worker.cancel()
                await asyncio.gather(*self._workers.values(), return_exceptions=True)

    @property
    def idle(self) -> bool:
        """Whether nothing is left to post."""
        return not self._workers

    async def send_notification(self, task_id: str, event: PushNotificationEvent) -> None:
        """Queue a task's update for each of its addresses; returns at once."""
        configs = await self._subscribers.get_info_for_dispatch(task_id)
        if not configs or self._client is None:
            return
        body = msgspec.json.encode(MessageToDict(to_stream_response(event)))
        for config in configs:
            key = task_id, config.id
            while self._count >= self._config.queue:
                self._drop()
            self._waiting.setdefault(key, deque()).append(_Waiting(config, body))
            self._count += 1
            if key not in self._workers:
                self._workers[key] = asyncio.ensure_future(self._work(key))

    def _drop(self) -> None:
        longest = max(self._waiting.values(), key=len)
        longest.popleft()
        self._count -= 1
        log.warning("push_dropped", waiting=self._count)

    async def _work(self, key: tuple[str, str]) -> None:
        queue = self._waiting[key]
        try:
            while queue:
                one = queue.popleft()
                self._count -= 1
                await self._deliver(key[0], one)
        finally:
            self._count -= len(queue)
            del self._waiting[key], self._workers[key]

    async def _deliver(self, task: str, one: _Waiting) -> None:
        wait = self._config.backoff
        for attempt in range(1, self._config.attempts + 1):
            try:
                again = await self._post(one)
            except Unknown as error:
                again = str(error)
            except Unfit as error:
                log.warning("push_refused", task=task, reason=str(error))
                return
            except httpx.HTTPError as error:
                again = type(error).__name__
            if again is None:
                return
            log.info("push_failed", task=task, attempt=attempt, reason=again)
            if attempt < self._config.attempts:
                await asyncio.sleep(wait)
                wait = min(2 * wait, _LONGEST_WAIT)
        log.warning("push_given_up", task=task, attempts=self._config.attempts)

    async def _post(self, one: _Waiting) -> str | None:
        """Post once; return why to retry, or None.

        :raises Unfit: the address is not allowed, or it refused permanently.
        """
        assert self._client is not None
        judged = await self._addresses.judge(one.config.url)
        headers = {"host": judged.host, "content-type": A2A_JSON_MEDIA_TYPE}
        if one.config.token:
            headers["x-a2a-notification-token"] = one.config.token
        auth = one.config.authentication
        if auth.scheme and auth.credentials:
            headers["authorization"] = f"{auth.scheme} {auth.credentials}"
        async with self._client.stream(
            "POST",
            judged.url,
            content=one.body,
            headers=headers,
            extensions={"sni_hostname": judged.name},
        ) as response:
            status = response.status_code
        if status < 300:
            return None
        if status in (408, 425, 429) or status >= 500:
            return f"answered {status}"
        raise Unfit(f"answered {status}")
