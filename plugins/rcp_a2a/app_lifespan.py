"""Puts the parts together while the gateway runs."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from importlib import import_module
from typing import Any

from rcp_a2a.addresses import Addresses
from rcp_a2a.agent import Agent
from rcp_a2a.app import App
from rcp_a2a.callers import Contexts
from rcp_a2a.cards import Cards
from rcp_a2a.config import A2aConfig, check
from rcp_a2a.handler import Handler
from rcp_a2a.logs import quieted
from rcp_a2a.places import CARD, PREFIX
from rcp_a2a.push import Notifier, Subscribers
from rcp_a2a.receipts import Receipts
from rcp_a2a.tasks import Tasks
from rcp_a2a.waiting import WaitingTasks
from rcp_gateway.client_api import ClientApi, Mount

__all__ = ["serving"]


@asynccontextmanager
async def serving(config: A2aConfig, client_api: ClientApi) -> AsyncGenerator[dict[str, Any]]:
    """Offer the agent while entered.

    :raises ConfigError: a key or CA cannot be read, or a network of `push` is none.
    """
    check(config)
    cards = Cards(config, client_api)
    addresses = Addresses(config.push)
    tasks = Tasks(client_api.store("tasks"), config)
    subscribers = Subscribers(client_api.store("push"), config.push.per_task)
    tasks.forgotten.append(subscribers.forget)
    receipts = Receipts(client_api.store("messages"))
    tasks.forgotten.append(receipts.forget)
    tasks.saved.append(receipts.saved)
    waiting = WaitingTasks(client_api.store("questions"))
    tasks.forgotten.append(waiting.forget)
    waiting.restore()
    tasks.restore(waiting.has)
    receipts.restore(tasks.has)
    subscribers.restore()
    notifier = Notifier(config.push, addresses, subscribers)
    handler = Handler(
        client_api,
        receipts,
        tasks,
        Agent(client_api, config.input_timeout, waiting),
        cards.plain(),
        push_config_store=subscribers if config.push.enabled else None,
        push_sender=notifier if config.push.enabled else None,
        request_context_builder=Contexts(tasks),
        extended_agent_card=cards.plain(),
        extended_card_modifier=cards.extended,
        push_url_validator=addresses.fits,
    )
    app = App(config, client_api, cards, handler)
    async with AsyncExitStack() as stack:
        stack.enter_context(quieted())
        await stack.enter_async_context(notifier.running())
        stack.callback(
            client_api.loop.call_later(config.input_timeout, tasks.expire, waiting.has).cancel
        )
        stack.push_async_callback(handler.aclose)
        facts: dict[str, Any] = {"path": PREFIX}
        if config.grpc is not None:
            most = min(config.message, client_api.limits.message)
            loaded = await asyncio.to_thread(import_module, "rcp_a2a.grpc_server")
            binding = loaded.serving_grpc(config.grpc, client_api, handler, most)
            facts["grpc"] = cards.grpc_port = await stack.enter_async_context(binding)
        for prefix in (PREFIX, CARD):
            mount = Mount(name="a2a", prefix=prefix, app=app)
            client_api.mount(mount)
            stack.callback(client_api.unmount, mount)
        yield facts
