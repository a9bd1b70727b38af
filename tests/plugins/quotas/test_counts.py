"""Whatever clients do, what a quota counts is what there is."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from contextlib import AsyncExitStack
from typing import Any

from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from kernel.world import Client, World, prepared, world_of
from plugins.quotas.home import AGENT, ANN, BOB, LEVEL, at_home, usages_of
from rcp_gateway.reload import apply
from rcp_kernel.config.file import parse
from rcp_kernel.errors import QueueFull
from rcp_quotas.usage import QuotaUsage

LOOSE = "\n[tenants.alpha.quota]\nsessions = 4\nsubscriptions = 5\ncommands = 3\n"
TIGHT = (
    "\n[tenants.alpha.quota]\nsubscriptions = 2\n[quotas.principal]\nsessions = 2\ncommands = 1\n"
)
QUOTAS = {"": "", "loose": LOOSE, "tight": TIGHT}
ACTIONS = ("/action/go", "/action/cut_in", "/action/wait_in_line", "/service/echo")


class Counts(RuleBasedStateMachine):
    """Clients that come, go, come back, subscribe and command, while quotas change."""

    def __init__(self) -> None:
        super().__init__()
        self.runner = asyncio.Runner()
        self.stack = AsyncExitStack()
        self.clients: list[Client] = []
        self.away: list[tuple[str, str]] = []
        self.usages: list[QuotaUsage] = []
        """All that have counted anything so far."""

    def do(self, work: Awaitable[Any]) -> Any:
        async def bounded() -> Any:
            async with asyncio.timeout(60):
                return await work

        return self.runner.run(bounded())

    @initialize(quota=st.sampled_from(list(QUOTAS)))
    def start(self, quota: str) -> None:
        self.world: World = self.do(
            self.stack.enter_async_context(world_of(at_home(QUOTAS[quota])))
        )

    @rule(token=st.sampled_from([ANN, AGENT, BOB]), hello=st.booleans())
    def connect(self, token: str, hello: bool) -> None:  # noqa: FBT001 - a drawn value
        async def work() -> None:
            try:
                client = self.world.client(token)
            except QueueFull:
                return
            self.clients.append(client)
            if hello:
                await client.ask(type="hello")

        self.do(work())

    @precondition(lambda self: self.clients)
    @rule(data=st.data())
    def leave(self, data: st.DataObject) -> None:
        async def work() -> None:
            client = self.clients.pop(data.draw(st.integers(0, len(self.clients) - 1)))
            session = client.connection.session
            if session.resumable:
                token = {"ann": ANN, "agent": AGENT, "bob": BOB}[session.principal.name]
                self.away.append((token, session.id))
            client.connection.close()

        self.do(work())

    @precondition(lambda self: self.away)
    @rule()
    def come_back(self) -> None:
        async def work() -> None:
            token, id_ = self.away.pop()
            try:
                client = self.world.client(token)
            except QueueFull:
                return
            self.clients.append(client)
            await client.ask(type="hello", body={"session": id_})

        self.do(work())

    @precondition(lambda self: self.clients)
    @rule(data=st.data(), count=st.sampled_from([None, 1]))
    def subscribe(self, data: st.DataObject, count: int | None) -> None:
        async def work() -> None:
            client = data.draw(st.sampled_from(self.clients))
            body = {} if count is None else {"count": count}
            await client.ask(type="subscribe", path=LEVEL, body=body)
            self.world.robot.host.publish("sensor/level", 1.0)

        self.do(work())

    @precondition(lambda self: self.clients)
    @rule(data=st.data())
    def unsubscribe(self, data: st.DataObject) -> None:
        async def work() -> None:
            client = data.draw(st.sampled_from(self.clients))
            await client.ask(type="unsubscribe", path=LEVEL)

        self.do(work())

    @precondition(lambda self: self.clients)
    @rule(data=st.data(), path=st.sampled_from(ACTIONS), input_=st.sampled_from([1, "x"]))
    def command(self, data: st.DataObject, path: str, input_: object) -> None:
        async def work() -> None:
            client = data.draw(st.sampled_from(self.clients))
            client.send(type="execute", path=path, body=input_)
            await client.ask(type="ping")

        self.do(work())

    @rule()
    def finish(self) -> None:
        async def work() -> None:
            self.world.robot.release.set()
            while self.world.server.gateway.commands.running:  # noqa: ASYNC110
                await asyncio.sleep(0.001)
            self.world.robot.release.clear()

        self.do(work())

    @rule(quota=st.sampled_from(list(QUOTAS)))
    def reload(self, quota: str) -> None:
        text = at_home(QUOTAS[quota])
        self.do(apply(self.world.server, prepared(parse(text, "test"), [])))

    @rule()
    def expire(self) -> None:
        async def work() -> None:
            sessions = self.world.server.gateway.sessions
            for session in [s for s in sessions.known.values() if s.cut is not None]:
                sessions.drop(session)

        self.do(work())

    @invariant()
    def counts_are_what_there_is(self) -> None:
        if not hasattr(self, "world"):
            return
        self.do(asyncio.sleep(0))
        kernel = self.world.server.gateway
        sessions = kernel.sessions.known.values()
        found = {usage for session in sessions for usage in usages_of(session)}
        self.usages += found - {*self.usages}
        for usage in self.usages:
            concerned = [s for s in sessions if usage in usages_of(s)]
            assert usage.sessions == set(concerned)
            running = {
                id_
                for id_, command in kernel.commands.running.items()
                if command.requester is not None and usage in usages_of(command.requester)
            }
            assert usage.commands == running
            for what in ("connected", "subscriptions"):
                assert getattr(usage, what) >= 0

    def teardown(self) -> None:
        if hasattr(self, "world"):
            self.world.robot.release.set()
            self.do(self.stack.aclose())
        self.runner.close()


def test_counts_never_drift() -> None:
    run_state_machine_as_test(
        Counts,
        settings=settings(
            max_examples=25,
            stateful_step_count=25,
            phases=[Phase.explicit, Phase.reuse, Phase.generate],
            suppress_health_check=list(HealthCheck),
        ),
    )
