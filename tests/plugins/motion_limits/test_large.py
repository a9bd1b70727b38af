"""Envelopes over a large tree hold nothing up, and none is late."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import thread_time

import pytest

from kernel.fenced import CONFIG, code
from kernel.world import Robot, World, features_of, world_of
from rcp_gateway.features import ActiveFeature
from rcp_kernel.config.file import parse
from rcp_kernel.errors import OutOfRange
from rcp_kernel.model import Resource
from rcp_kernel.sessions.session import Session

pytestmark = pytest.mark.anyio
MANY = 20_000
LONGEST = 0.02  # s of one turn of the loop
EVERYWHERE = """
[[envelopes]]
name = "everywhere"
paths = ["/param/**"]
bounds = { "" = { max = 1 } }
"""


class Large(Robot):
    """A robot with thousands of parameters."""

    def declare(self) -> None:
        super().declare()
        for number in range(MANY):
            self.add(Resource(name=f"param/p{number}", description="A number.", value=float))


@contextmanager
def short() -> Iterator[None]:
    """Prove that what is done while entered fits into a turn of the loop."""
    began = thread_time()
    yield
    assert thread_time() - began < LONGEST


def features(envelopes: str) -> tuple[ActiveFeature, ...]:
    return features_of(parse(CONFIG + envelopes, "test"))


def limit_is_known(world: World, session: Session, path: str) -> bool:
    """Ask, in this very turn, whether a value beyond the bound would be refused."""
    entry = world.server.gateway.registry.entries[f"/tenant/alpha{path}"]
    try:
        world.server.gateway.features.foresee(session, entry, 2.0)
    except OutOfRange:
        return True
    return False


async def test_a_reload_over_a_large_tree_is_short_and_its_limits_count_at_once() -> None:
    async with world_of(CONFIG, Large) as world:
        kernel, client = world.server.gateway, world.client()
        assert len(kernel.registry.entries) > MANY
        last = f"/param/p{MANY - 1}"
        assert code(await client.ask(type="write", path=last, body=2.0)) == "completed"
        wanted = features(EVERYWHERE)
        with short():
            kernel.features.reconfigure(wanted)
        assert limit_is_known(world, client.connection.session, last)
        kernel.reconfigure(parse(CONFIG + EVERYWHERE, "test"), features(EVERYWHERE))
        for number in (19_998, 1, 10_000):
            path = f"/param/p{number}"
            assert code(await client.ask(type="write", path=path, body=2.0)) == "out_of_range"
            assert code(await client.ask(type="write", path=path, body=1.0)) == "completed"
        wanted = features("")
        with short():
            kernel.features.reconfigure(wanted)
        assert not limit_is_known(world, client.connection.session, last)
