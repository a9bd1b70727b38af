"""What a feature can count and refuse of sessions, and what none of them can keep anybody from."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import pytest

from kernel.world import CONFIG, Client, Robot, World, prepared
from rcp_gateway.features import active
from rcp_gateway.server import running
from rcp_kernel.config.file import parse
from rcp_kernel.contract.metrics import counter
from rcp_kernel.errors import QueueFull, RateLimited, RcpError
from rcp_kernel.features import Feature, FeatureHost, FeatureKind
from rcp_kernel.sessions.session import Session
from steps import finished

pytestmark = pytest.mark.anyio
LEVEL = "/tenant/alpha/sensor/level"


class NoKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Nothing to configure."""


class Bill:
    """Counts all that everybody does, and refuses what a test says."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.requests = 0
        self.commands: set[str] = set()
        self.sessions: list[Session] = []
        self.refused: set[str] = set()
        self.broken = False

    # -- Accounting --------------------------------------------------------------------------------

    def attach(self, session: Session) -> Bill:
        self._stumble()
        return self

    def enter(self, session: Session, drop: Callable[[Session], None]) -> Bill:
        self._check("sessions")
        self.sessions.append(session)
        return self

    def move(self, session: Session) -> Bill:
        self._stumble()
        return self

    def check_tenant(self, session: Session, tenant: str | None) -> None:
        self._check(f"tenant {tenant}")

    def leave(self, session: Session) -> None:
        self._stumble()
        if session in self.sessions:
            self.sessions.remove(session)

    def forget_commands(self) -> None:
        self.commands.clear()

    # -- SessionAccount ----------------------------------------------------------------------------

    def take(self, moment: float) -> bool:
        self._stumble()
        if not self.allows(moment):
            return False
        self.requests += 1
        return True

    def allows(self, moment: float) -> bool:
        return "requests" not in self.refused

    def refusal(self, moment: float) -> RcpError:
        return RateLimited(f"{self.name}: not paid", retry_after=1.0)

    def check_subscription(self) -> None:
        self._check("subscriptions")

    def check_command(self, path: str) -> None:
        self._check(path)

    def add_command(self, id_: str, path: str) -> Callable[[], None]:
        self._stumble()
        self.commands.add(id_)
        return lambda: self.commands.discard(id_)

    def _check(self, what: str) -> None:
        if what in self.refused:
            raise QueueFull(f"{self.name}: too many")

    def _stumble(self) -> None:
        if self.broken:
            raise ZeroDivisionError

    # -- the feature -------------------------------------------------------------------------------

    def kind(self) -> FeatureKind:
        def tell(session: Session) -> dict[str, Any]:
            self._stumble()
            return {self.name: [session.principal.name, self.requests]}

        def metrics() -> list[Any]:
            self._stumble()
            return [counter(f"{self.name}_requests", "Counted.", (), [([], self.requests)])]

        def make(_table: NoKeys, _host: FeatureHost) -> Feature:
            return Feature(accounting=self, reader_status=tell, metrics=metrics)

        return FeatureKind(self.name, NoKeys, make)


@asynccontextmanager
async def billed(*bills: Bill) -> AsyncGenerator[World]:
    """Run a gateway with these beside the built-in features."""
    robots: list[Robot] = []
    config = parse(CONFIG, "test")
    kinds = {bill.name: bill.kind() for bill in bills}
    wanted = msgspec.structs.replace(config, features=dict.fromkeys(kinds, True))
    made = prepared(config, robots)
    features = (*made.features, *active(wanted, kinds, "test"))
    made = msgspec.structs.replace(made, features=features)
    async with running(made) as server:
        yield World(server, robots)


async def test_requests_subscriptions_and_commands_are_counted_and_refused() -> None:
    bill = Bill("bill")
    async with billed(bill) as world:
        client = world.client()
        assert (await client.ask(type="ping"))["status"] == "completed"
        assert bill.requests == 1
        parts = [{"type": "ping", "id": "p"}]
        assert (await client.ask(type="batch", body=parts))["body"][0]["status"] == "completed"
        assert bill.requests == 3

        bill.refused = {"requests"}
        refused = await client.ask(type="ping")
        assert refused["error"]["message"] == "bill: not paid"

        bill.refused = {"subscriptions", "/tenant/alpha/action/go"}
        refused = await client.ask(type="subscribe", path=LEVEL)
        assert refused["error"]["code"] == "queue_full"
        refused = await client.ask(type="execute", path="/action/go", body=1.0)
        assert refused["error"]["code"] == "queue_full"
        assert not bill.commands

        bill.refused = set()
        id_ = client.send(type="execute", path="/action/go", body=1.0)
        begun = await client.until(lambda m: m.get("status") == "in_progress")
        assert bill.commands == {begun["command"]}
        world.robot.release.set()
        await client.final(id_)
        assert bill.commands == set()


async def test_sessions_are_counted_and_refused() -> None:
    bill = Bill("bill")
    async with billed(bill) as world:
        client = world.client()
        assert bill.sessions == [client.connection.session]
        client.connection.close()
        assert bill.sessions == []
        bill.refused = {"sessions"}
        with pytest.raises(QueueFull, match="bill: too many"):
            world.client()
        assert bill.sessions == []


async def test_several_features_count_together_and_each_may_refuse() -> None:
    one, two = Bill("one"), Bill("two")
    async with billed(one, two) as world:
        client = world.client()
        assert (await client.ask(type="ping"))["status"] == "completed"
        two.refused = {"requests", "sessions"}
        refused = await client.ask(type="ping")
        assert refused["error"]["message"] == "two: not paid"
        assert (one.requests, two.requests) == (1, 1)
        with pytest.raises(QueueFull):
            world.client()
        assert one.sessions == [client.connection.session]
        two.refused = set()
        id_ = client.send(type="execute", path="/action/go", body=1.0)
        begun = await client.until(lambda m: m.get("status") == "in_progress")
        assert one.commands == two.commands == {begun["command"]}
        world.robot.release.set()
        await client.final(id_)
        assert one.commands == two.commands == set()


@pytest.mark.parametrize("broken", [False, True])
async def test_no_account_keeps_anybody_from_stopping_a_robot(*, broken: bool) -> None:
    bill = Bill("bill")
    async with billed(bill) as world:
        client = world.client()
        bill.refused, bill.broken = {"requests", "/tenant/alpha/service/hold"}, broken
        for stop in (
            {"type": "write", "path": "/actuator/drive", "body": {}},
            {"type": "execute", "path": "/service/hold"},
            {"type": "cancel", "path": "/action/go"},
            {"type": "execute", "path": "/system/estop", "body": {}},
        ):
            assert (await client.ask(**stop))["status"] == "completed"
        assert (await client.ask(type="ping"))["status"] == "rejected"


async def test_a_plan_that_only_stops_runs_whatever_counts_it() -> None:
    bill = Bill("bill")
    async with billed(bill) as world:
        client = world.client()
        bill.refused, bill.broken = {"requests", "/system/plans"}, True
        body = {"steps": [{"do": "execute", "path": "/service/hold"}]}
        reply = await client.ask(type="execute", path="/system/plans", body=body)
        assert reply["status"] == "completed", reply


async def test_who_comes_in_without_a_connection_is_let_in_by_a_feature_with_a_bug() -> None:
    bill = Bill("bill")
    async with billed(bill) as world:
        bill.broken = True
        client_api = world.server.client_api
        session = client_api.session(client_api.authenticate("operator-operator"))
        assert session.account is None


async def test_each_reader_is_told_of_itself_and_the_operator_by_metrics() -> None:
    bill = Bill("bill")
    async with billed(bill) as world:
        client = world.client()
        await client.ask(type="ping")
        assert (await client.ask(type="status"))["body"]["bill"] == ["operator", 2]
        admin = world.client("admin-admin-admin")
        assert (await admin.ask(type="status"))["body"]["bill"] == ["admin", 3]
        assert "bill_requests_total 3.0" in scraped(world, admin)
        bill.broken = True
        assert "bill_requests" not in scraped(world, admin)
        assert "rcp_sessions" in scraped(world, admin)


def scraped(world: World, client: Client) -> str:
    session = client.connection.session
    account, session.account = session.account, None
    text = finished(world.server.client_api.metrics(session)).decode()
    session.account = account
    return text
