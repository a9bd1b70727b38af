"""Notifications reach the host that was named and proved itself, in order, within bounds."""

from __future__ import annotations

import asyncio
import socket
import ssl
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from a2a.types.a2a_pb2 import (
    TaskPushNotificationConfig,
    TaskState,
    TaskStatus,
    TaskStatusUpdateEvent,
)
from cryptography import x509

from certs import Authority
from plugins.a2a.receiver import ANSWER, BOUND, receiver
from plugins.a2a.test_tasks import called_by
from rcp_a2a.addresses import Addresses
from rcp_a2a.config import PushConfig
from rcp_a2a.push import Notifier, Subscribers
from rcp_kernel.errors import ConfigError
from rcp_store.plugin_store import PluginStore
from rcp_store.store import Store

pytestmark = pytest.mark.anyio
LOCAL = ("127.0.0.0/8",)


@asynccontextmanager
async def notifying(url: str, **config: Any) -> AsyncGenerator[Notifier]:
    """Run a notifier of one task with one address."""
    made = PushConfig(private=LOCAL, backoff=0.01, **config)
    subscribers = Subscribers(PluginStore(Store(), "push"), 4)
    await subscribers.set_info("t", TaskPushNotificationConfig(url=url), called_by("ada"))
    notifier = Notifier(made, Addresses(made), subscribers)
    async with notifier.running():
        yield notifier


def said(number: int) -> TaskStatusUpdateEvent:
    event = TaskStatusUpdateEvent(
        task_id="t", context_id="c", status=TaskStatus(state=TaskState.TASK_STATE_WORKING)
    )
    event.metadata["number"] = number
    return event


def numbers(bodies: list[Any]) -> list[int]:
    return [int(body["statusUpdate"]["metadata"]["number"]) for body in bodies]


@pytest.fixture
async def named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have every name lead to this machine."""

    async def getaddrinfo(name: str, port: int, **_: Any) -> list[Any]:
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", port))]

    monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", getaddrinfo)


def serving(folder: Path, name: str) -> tuple[Authority, ssl.SSLContext]:
    authority = Authority(folder)
    signed = authority.sign(name, sans=(x509.DNSName(name),))
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(*signed.pair)
    return authority, context


@pytest.mark.usefixtures("named")
async def test_a_host_that_proves_its_name_is_posted_to(tmp_path: Path) -> None:
    authority, tls = serving(tmp_path, "hook.example")
    async with receiver(tls) as hook:
        url = f"https://hook.example:{hook.port}/hook"
        async with notifying(url, ca=str(authority.file)) as notifier:
            await notifier.send_notification("t", said(1))
            await hook.got(1)
    assert hook.heads[0]["host"] == f"hook.example:{hook.port}"


@pytest.mark.usefixtures("named")
async def test_a_host_that_proves_another_name_gets_nothing(tmp_path: Path) -> None:
    authority, tls = serving(tmp_path, "other.example")
    async with receiver(tls) as hook:
        url = f"https://hook.example:{hook.port}/hook"
        async with notifying(url, ca=str(authority.file), attempts=2) as notifier:
            await notifier.send_notification("t", said(1))
            await worked(notifier)
    assert hook.bodies == []


async def worked(notifier: Notifier) -> None:
    """Wait until nothing is left to post."""
    async with asyncio.timeout(BOUND):
        while not notifier.idle:  # noqa: ASYNC110 - it tells nobody
            await asyncio.sleep(0.005)


async def test_the_oldest_give_way_where_nobody_takes_them() -> None:
    async with receiver() as hook:
        hook.answers += [ANSWER % b"503 Busy"] * 50
        async with notifying(hook.url, http=True, queue=3, attempts=20) as notifier:
            await notifier.send_notification("t", said(0))
            await hook.got(1)  # the first one is being tried, again and again
            for number in range(1, 8):
                await notifier.send_notification("t", said(number))
            hook.answers.clear()
            await worked(notifier)
    told = numbers(hook.bodies)
    assert [n for i, n in enumerate(told) if i == 0 or told[i - 1] != n] == [0, 5, 6, 7]


async def test_what_is_never_taken_is_given_up_and_the_next_is_tried() -> None:
    async with receiver() as hook:
        hook.answers += [ANSWER % b"503 Busy"] * 2
        async with notifying(hook.url, http=True, attempts=2) as notifier:
            await notifier.send_notification("t", said(1))
            await notifier.send_notification("t", said(2))
            await worked(notifier)
    assert numbers(hook.bodies) == [1, 1, 2]


async def test_an_end_waits_for_no_address() -> None:
    async with receiver() as hook, asyncio.timeout(BOUND):
        hook.answers += [ANSWER % b"503 Busy"] * 100
        async with notifying(hook.url, http=True, attempts=20) as notifier:
            await notifier.send_notification("t", said(1))
            await hook.got(2)


def test_cas_that_cannot_be_read_are_told_with_their_place(tmp_path: Path) -> None:
    config = PushConfig(ca=str(tmp_path / "none.pem"))
    with pytest.raises(ConfigError, match=r"\[plugins.a2a.push\] ca"):
        Notifier(config, Addresses(config), Subscribers(PluginStore(Store(), "push"), 1))
