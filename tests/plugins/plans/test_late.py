"""What a plan has sent does not begin after the plan has ended."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Generator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

import msgspec
import pytest

from kernel.world import BOUND, CONFIG, Robot, World, prepared
from plugins.plans.planned import send, step
from rcp_gateway.features import active
from rcp_gateway.plugins import Plugins
from rcp_gateway.server import running
from rcp_kernel.config.file import GatewayConfig, parse
from rcp_kernel.features import Feature, FeatureHost, FeatureKind
from rcp_kernel.features.action import ActionHost
from rcp_kernel.features.resource import SystemResource
from rcp_kernel.model import Operation, Resource
from rcp_kernel.values import Encoding, dump, value_type
from rcp_kernel.wire import Reply, Request

pytestmark = pytest.mark.anyio
PATH = "/system/recording"
TEXT = value_type(str)


class NoKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Nothing to configure."""


@dataclass
class Recording:
    """An action of a feature, whose check lasts until a test ends it."""

    checked: asyncio.Event
    asked: asyncio.Event
    ran: list[str]
    host: ActionHost | None = None
    input: Any = None
    touches: tuple[str, ...] = ()

    def admit(self, session: Any, running: Sequence[Any]) -> None:
        """Take any."""

    def stops(self, request: Any, is_stop: Any) -> bool:
        """Stop nothing."""
        return False

    def show(self, command: Any) -> Any:
        """Show nothing of it."""
        return "one"

    def prepare(
        self, session: Any, request: Any, entry: Any, host: ActionHost
    ) -> Generator[None, None, Any]:
        """Wait for its turn."""
        self.host = host
        self.asked.set()
        while not self.checked.is_set():
            yield
        return self

    def dry_run(self) -> Mapping[str, Any]:
        """Say nothing."""
        return {}

    def begin(self, session: Any, request: Any, entry: Any) -> None:
        """Begin."""

    def report(self, *, over: bool = False) -> Any:
        """Say nothing."""
        return "one"

    def outline(self, report: Any) -> Any:
        """Record nothing."""
        return None

    async def run(self, command: Any, session: Any, progress: Any) -> Any:
        """Note that it began."""
        self.ran.append(command.request.decode_body(TEXT))
        return "one"


def recording() -> tuple[Recording, FeatureKind]:
    """Make the feature."""
    made = Recording(asyncio.Event(), asyncio.Event(), [])
    resource = Resource(
        name="action/recording",
        description="Records.",
        value=list[str],
        input=str,
        output=str,
        operations=Operation.READ | Operation.EXECUTE,
        policy="parallel",
    )

    def make(_table: NoKeys, _host: FeatureHost) -> Feature:
        action: Any = made
        return Feature(resources=(SystemResource(resource=resource, action=action),))

    return made, FeatureKind("recording", NoKeys, make)


@asynccontextmanager
async def world_with(kind: FeatureKind) -> AsyncGenerator[World]:
    """Run a gateway with a feature beside its own."""
    robots: list[Robot] = []
    config = msgspec.structs.replace(parse(CONFIG, "test"), features={kind.name: True})
    features = active(config, {**Plugins(GatewayConfig()).features, kind.name: kind}, "test")
    made = msgspec.structs.replace(prepared(config, robots), features=features)
    async with running(made) as server:
        yield World(server, robots)


async def test_an_action_of_a_feature_does_not_begin_after_its_plan_was_cancelled() -> None:
    made, kind = recording()
    async with world_with(kind) as world:
        client = world.client("admin-admin-admin")
        id_ = send(client, step("execute", PATH, "of the plan"))
        await asyncio.wait_for(made.asked.wait(), BOUND)
        await client.final(client.send(type="cancel", path="/system/plans"))
        assert (await client.final(id_))["status"] == "cancelled"
        made.checked.set()
        # Behind that of the plan, in the turns of the same person.
        reply = await client.final(client.send(type="execute", path=PATH, body="later"))
        assert reply["status"] == "completed", reply
        assert made.ran == ["later"]


@pytest.mark.parametrize(("do", "path"), [("execute", "service/echo"), ("write", "param/text")])
async def test_a_long_step_to_a_resource_that_is_gone_is_refused_at_once(
    do: Any, path: str
) -> None:
    made, kind = recording()
    async with world_with(kind) as world:
        world.robot.add(Resource(name="param/text", description="A text.", value=str))
        client = world.client("admin-admin-admin")
        client.send(type="execute", path=PATH, body="first")
        await asyncio.wait_for(made.asked.wait(), BOUND)
        made.checked.set()
        host, session = made.host, client.connection.session
        assert host is not None
        world.robot.remove(path)
        body = msgspec.Raw(dump("a" * 60_000, Encoding.JSON))
        request = Request(type=do, path=f"/tenant/alpha/{path}", body=body)
        owner, busy, replies = session.principal.identity, ["busy"], list[Reply]()
        request = await host.turns.finish(owner, host.prepare(session, request))
        host.turns.run(owner, _others(busy))  # work of the same person
        host.send(session, request, replies.append)
        busy.clear()
        assert [one.error["code"] for one in replies if one.error] == ["unknown_path"]


def _others(busy: list[str]) -> Generator[None]:
    while busy:
        yield
