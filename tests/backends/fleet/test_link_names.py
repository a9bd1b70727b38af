"""A hub and a robot have any number of links in their lives, on a few keys."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any, cast

import pytest

pytest.importorskip("zenoh")

import zenoh

from backends.fleet.rig import robot_at, serving
from ports import free_port
from rcp_client.address import Address
from rcp_client.carrier import Lost, Received
from rcp_client.client import Client
from rcp_client.messages import Codec
from rcp_client.settings import Settings
from rcp_fleet.link import FleetLink, FleetLinks
from rcp_fleet.link_names import LinkNames
from rcp_gateway.testing import OPERATOR, eventually
from rcp_zenoh.declared_keys import DeclaredKeys
from rcp_zenoh.keys import alive
from rcp_zenoh.session import configuration, on_loop, opened
from rcp_zenoh.statistics import LinkStatistics
from transports.cable import Cable

_BOUND = 60.0  # s, on any machine
_LINKS = 6
_NUMBERS = 65_535  # that a Zenoh session has for keys


class _Counting:
    """A session that notes each key which takes one of its numbers."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self.taken: list[str] = []

    def declare_keyexpr(self, key: str) -> zenoh.KeyExpr:
        self.taken.append(key)
        return self._session.declare_keyexpr(key)

    def declare_publisher(self, key: str | zenoh.KeyExpr, **options: Any) -> zenoh.Publisher:
        if isinstance(key, str):
            self.taken.append(key)
        return self._session.declare_publisher(key, **options)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)

    @property
    def seen(self) -> zenoh.Session:
        """Return itself, as what it passes for."""
        return cast("zenoh.Session", self)


class _Hub:
    """A hub's links with the gateway r7, and their names."""

    def __init__(self, session: zenoh.Session, step: float, silence: float) -> None:
        """Let the names rest for as many looks at the clock as it takes in steps of `step` s."""
        clock = itertools.count(step=step)
        self._names = LinkNames(lambda: float(next(clock)))
        self._links = FleetLinks(session, self._names, "alpha", "h1", silence)
        self.receiving = self._links.receiving
        self.opened = 0

    async def _dial(self, codec: Codec, received: Received, lost: Lost) -> FleetLink:
        self.opened += 1
        return self._links.open("r7", LinkStatistics({}), lambda _: None, codec, received, lost)

    def client(self, timeout: float = _BOUND) -> Client:
        """Return a client that speaks over them."""
        settings = Settings(
            address=Address.parse("fleet"),
            token=OPERATOR,
            connect_timeout=timeout,
            patience=None,
            longest_pause=0.1,
            dial=self._dial,
        )
        return Client(settings)


@asynccontextmanager
async def _joined(session: zenoh.Session) -> AsyncGenerator[None]:
    """Wait until the gateway r7 can answer."""
    here = asyncio.Event()
    note = on_loop(asyncio.get_running_loop(), lambda _: here.set())
    token = session.liveliness().declare_subscriber(alive("alpha", "r7"), note, history=True)
    try:
        async with asyncio.timeout(_BOUND):
            await here.wait()
        yield
    finally:
        token.undeclare()


def test_a_name_is_used_again_when_it_has_rested_and_not_before() -> None:
    now = 1000.0
    names = LinkNames(lambda: now)
    first, second = names.take("r7"), names.take("r7")
    assert first != second
    names.release("r7", first)
    now += 59.9
    third = names.take("r7")
    assert third not in (first, second)
    assert "." not in third, "that would be an encoding"
    names.release("r7", second)
    now += 0.2
    assert names.take("r7") == first
    assert names.take("r7") not in (first, second, third)
    now += 60.0
    assert names.take("r7") == second


def test_another_run_has_other_names() -> None:
    assert LinkNames(lambda: 0.0).take("r7") != LinkNames(lambda: 0.0).take("r7")


def test_a_fleet_whose_links_all_end_each_second_does_not_use_up_the_numbers() -> None:
    now = 0.0
    names = LinkNames(lambda: now)
    gateways = [f"r{number}" for number in range(1000)]
    taken = set[tuple[str, str]]()
    for _ in range(60):
        links = [(gateway, names.take(gateway)) for gateway in gateways]
        taken.update(links)
        for link in links:
            names.release(*link)
        now += 0.5
    keys = 2 * len(taken)
    assert keys < _NUMBERS


async def test_a_key_is_declared_once() -> None:
    async with opened(configuration("router"), patient=False) as session:
        counting = _Counting(session)
        declared = DeclaredKeys(counting.seen)
        keys = [declared.of(f"a/{number % 2}") for number in range(_LINKS)]
        assert [str(key) for key in keys[:2]] == ["a/0", "a/1"]
        assert counting.taken == ["a/0", "a/1"]


async def test_links_after_links_take_the_keys_of_a_few(monkeypatch: pytest.MonkeyPatch) -> None:
    robots: list[_Counting] = []

    @asynccontextmanager
    async def counted(config: zenoh.Config, *, patient: bool) -> AsyncGenerator[zenoh.Session]:
        async with opened(config, patient=patient) as session:
            robots.append(_Counting(session))
            yield robots[-1].seen

    monkeypatch.setattr("rcp_zenoh.transport.opened", counted)
    port = free_port()
    router = configuration("router", listen=[f"tcp/127.0.0.1:{port}"])
    async with opened(router, patient=False) as session:
        counting = _Counting(session)
        hub = _Hub(counting.seen, step=31.0, silence=3.0)  # two names, in turn
        async with serving(robot_at(port)), _joined(session), hub.receiving():
            for _ in range(_LINKS):
                async with hub.client() as client:
                    await client.read("/tenant/alpha/sensor/pose")
    (robot,) = robots
    links = {key.rpartition("/")[2] for key in counting.taken}
    assert len(links) == 2
    assert sorted(counting.taken) == sorted(
        f"rcp/alpha/r7/{way}/h1/{link}" for way in ("in", "out") for link in links
    )
    assert sorted(robot.taken) == sorted(f"rcp/alpha/r7/out/h1/{link}" for link in links)


async def test_links_after_links_leave_the_keys_of_others_alone() -> None:
    port = free_port()
    router = configuration("router", listen=[f"tcp/127.0.0.1:{port}"])
    client = configuration("client", connect=[f"tcp/127.0.0.1:{port}"])
    async with (
        opened(router, patient=False) as far,
        serving(robot_at(port)),
        opened(client, patient=False) as session,
    ):
        arrived = list[str]()
        note = on_loop(asyncio.get_running_loop(), lambda one: arrived.append(str(one.key_expr)))
        subscriber = far.declare_subscriber("held/*", note)
        held = [session.declare_keyexpr(f"held/{number}") for number in range(10)]
        hub = _Hub(session, step=31.0, silence=3.0)  # two names, in turn
        async with _joined(session), hub.receiving():
            for _ in range(_NUMBERS - 25):  # as in a long life
                session.undeclare(session.declare_keyexpr("spent"))
            for _ in range(3 * _LINKS):
                async with hub.client() as one:
                    await one.read("/tenant/alpha/sensor/pose")
            for key in held:
                session.put(key, b"")

            async def all_came() -> bool:
                return sorted(arrived) == sorted(map(str, held))

            await eventually(all_came, "each message came on its key", _BOUND)
        subscriber.undeclare()


@pytest.mark.parametrize("fault", ["part", "freeze"])
async def test_a_robot_that_was_away_takes_a_name_that_was_used_again(fault: str) -> None:
    port = free_port()
    router = configuration("router", listen=[f"tcp/127.0.0.1:{port}"], silence=1.0)
    async with opened(router, patient=False) as session, Cable(port).laid() as cable:
        counting = _Counting(session)
        hub = _Hub(counting.seen, step=61.0, silence=1.0)  # one name, which does not rest
        robot = robot_at(cable.port).replace("\ngateway = ", "\nsilence = 1.0\ngateway = ")
        async with (
            serving(robot),
            _joined(session),
            hub.receiving(),
            hub.client(timeout=1.0) as client,
        ):
            await client.read("/tenant/alpha/sensor/pose")
            getattr(cable, fault)()

            async def used_again() -> bool:
                return hub.opened > 1

            await eventually(used_again, "the name is used again", _BOUND)
            cable.mend()

            async def back() -> bool:
                return client.connected

            await eventually(back, "the robot answers", _BOUND)
            await client.read("/tenant/alpha/sensor/pose")
    assert len(counting.taken) == 2
