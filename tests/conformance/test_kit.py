"""The kit finds what it is there to find: each flaw fails the test that is about it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncGenerator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from typing import Any

import msgspec
import pytest

from rcp_gateway.server import Server
from rcp_gateway.testing import (
    ADMIN,
    BackendSuite,
    Client,
    Goal,
    MemoryClient,
    Robot,
    TransportSuite,
    loopback,
    serve_backend,
)
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError, DeviceRejected
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend, Host, Progress
from rcp_kernel.types import quantity
from rcp_kernel.values import Encoding

Metres = quantity("m", ge=0, le=10)


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    start: Metres = 1.0  # pyright: ignore[reportInvalidTypeForm]


class Lift(BaseBackend):
    """A lift without a flaw; each flaw below is a change of one thing in it."""

    value: Any = Metres

    def __init__(self, options: Options, host: Host) -> None:
        self.host, self.height, self.limit, self.moving = host, options.start, 2.0, False
        self.floor = 0.0
        self.refused: set[str] = set()

    def declare(self) -> None:
        self.host.declare(
            Resource(name="sensor/height", description="Height.", value=self.value),
            Resource(name="param/limit", description="Limit.", value=Metres, examples=(3.0,)),
            Resource(name="action/lift", description="Lift.", input=Metres, output=Metres),
        )

    async def read(self, name: str) -> Any:
        return self.limit if name == "param/limit" else self.height

    async def write(self, name: str, value: Any) -> Any:
        self.limit = value

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        if value > 9:
            raise DeviceRejected("the roof is in the way")
        self.moving = True
        try:
            while abs(value - self.height) > 1e-6:
                progress(fraction=0.5)
                self.height += max(-0.1, min(0.1, value - self.height))
                await asyncio.sleep(0.005)
        finally:
            await self.halt()
        return self.height

    @asynccontextmanager
    async def _watching(self, name: str) -> AsyncGenerator[None]:
        self.host.publish(name, self.height)
        yield

    def watch(self, name: str, rate: float | None) -> Any:
        return self._watching(name)

    async def halt(self) -> None:
        self.moving = False


@asynccontextmanager
async def open_lift(lift: Lift) -> AsyncGenerator[Lift]:
    lift.declare()
    yield lift


def suite_of(kind: type[Lift]) -> BackendSuite:
    """Return the suite of a lift as its author would write it."""

    def opened(options: Options, host: Host) -> Any:
        return open_lift(kind(options, host))

    class LiftSuite(BackendSuite):
        async def truth(self, name: str) -> Any:
            lift = self.backend
            return {"param/limit": lift.limit, "param/floor": lift.floor}.get(name, lift.height)

        @asynccontextmanager
        async def refusing(self, name: str) -> AsyncGenerator[None]:
            self.backend.refused = {name}
            yield
            self.backend.refused = set()

        async def at_rest(self) -> bool:
            return not self.backend.moving

        def goals(self) -> Mapping[str, Goal]:
            return {"action/lift": Goal(good=1.2, bad=9.5, long=8.0)}

    LiftSuite.kind = BackendKind("lift", Options, opened)
    LiftSuite.cancel_within = LiftSuite.first_within = 0.5
    LiftSuite.complete_within = 2.0
    return LiftSuite()


TESTS = sorted(name for name in dir(BackendSuite) if name.startswith("test_"))


async def prove(suite: BackendSuite, test: str) -> None:
    """Run one test of a suite, with the robot that it asks for."""
    found: Callable[..., Any] = getattr(suite, test)
    if "robot" not in found.__code__.co_varnames[: found.__code__.co_argcount]:
        result = found()
        if result is not None:
            await result
        return
    async with suite.opened() as robot:
        assert isinstance(robot, Robot)
        await found(robot)


@pytest.mark.parametrize("test", TESTS)
async def test_a_lift_without_a_flaw_passes(test: str) -> None:
    with suppress(pytest.skip.Exception):
        await prove(suite_of(Lift), test)


class Pair(Lift):
    """Has two settings that it takes as one."""

    def declare(self) -> None:
        super().declare()
        facts: dict[str, Any] = {"value": Metres, "examples": (3.0, 4.0), "atomic": "limits"}
        self.host.declare(
            Resource(name="param/limit", description="Limit.", **facts),
            Resource(name="param/floor", description="Lowest height.", **facts),
        )

    async def read(self, name: str) -> Any:
        return self.floor if name == "param/floor" else await super().read(name)

    async def write(self, name: str, value: Any) -> Any:
        if name in self.refused:
            raise DeviceRejected("locked")
        if name == "param/floor":
            self.floor = value
        else:
            self.limit = value

    async def write_together(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        if self.refused & values.keys():
            raise DeviceRejected("locked")
        for name, value in values.items():
            await self.write(name, value)
        return {}


PAIR = [name for name in TESTS if "written_as_one" in name or "keeps_the_others" in name]


@pytest.mark.parametrize("test", PAIR)
async def test_a_lift_that_takes_two_settings_as_one_passes(test: str) -> None:
    await prove(suite_of(Pair), test)


class OneByOne(Pair):
    async def write_together(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        for name, value in values.items():
            await self.write(name, value)
        return {}


class OneOnly(Pair):
    async def write_together(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        await self.write(*next(iter(values.items())))
        return {}


class Deaf(Lift):
    async def write(self, name: str, value: Any) -> Any:
        return value


class Lenient(Lift):
    async def write(self, name: str, value: Any) -> Any:
        self.limit = value / 2
        return value


class Crude(Lift):
    async def read(self, name: str) -> Any:
        raise KeyError(name)


class Wordy(Lift):
    async def read(self, name: str) -> Any:
        return "high"


class Bare(Lift):
    value = float


class Mute(Lift):
    def watch(self, name: str, rate: float | None) -> Any:
        return BaseBackend.watch(self, name, rate)


class Stubborn(Lift):
    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        while value > 9 or abs(value - 1.2) > 1:
            with suppress(asyncio.CancelledError):
                await asyncio.sleep(0.7)
            if value < 9:
                return 1.0
        return await super().execute(name, value, progress)


class Liar(Lift):
    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        return value


class Runaway(Lift):
    async def halt(self) -> None:
        """Go on."""


class Leaky(Lift):
    def declare(self) -> None:
        super().declare()
        self.task = asyncio.create_task(asyncio.sleep(60), name="left behind")


class Chatty(Lift):
    async def _chat(self) -> None:
        while True:
            self.host.publish("sensor/height", self.height)
            await asyncio.sleep(0.02)

    def declare(self) -> None:
        super().declare()
        self.task = asyncio.create_task(self._chat(), name="chat")


class Threaded(Lift):
    def declare(self) -> None:
        super().declare()
        thread = threading.Thread(target=self.host.publish, args=("sensor/height", 1.0))
        thread.start()
        thread.join()


class Forgetful(Lift):
    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        raise ZeroDivisionError("a bug")


FLAWS: list[tuple[type[Lift], str]] = [
    (OneByOne, "test_one_that_the_device_refuses_keeps_the_others_from_it"),
    (OneOnly, "test_what_is_written_as_one_is_in_force_as_a_whole"),
    (Deaf, "test_a_write_changes_the_device"),
    (Lenient, "test_a_write_changes_the_device"),
    (Crude, "test_nothing_but_typed_errors_escapes"),
    (Crude, "test_what_can_be_read_arrives_typed_within_a_second"),
    (Wordy, "test_what_can_be_read_arrives_typed_within_a_second"),
    (Bare, "test_its_numbers_have_units"),
    (Mute, "test_a_subscriber_has_a_typed_first_value"),
    (Stubborn, "test_a_goal_can_be_cancelled_and_the_robot_rests"),
    (Liar, "test_a_good_goal_completes_in_the_state_it_reports"),
    (Liar, "test_a_goal_that_the_robot_cannot_do_fails_with_a_reason"),
    (Runaway, "test_a_halt_brings_it_to_rest"),
    (Runaway, "test_it_is_closed_at_rest"),
    (Runaway, "test_an_estop_brings_it_to_rest_and_ends_its_commands"),
    (Leaky, "test_it_leaves_no_task_thread_or_socket_behind"),
    (Chatty, "test_leaving_ends_the_production_of_what_is_not_live"),
    (Threaded, "test_the_loops_thread_alone_is_used_for_what_is_the_loops"),
    (Forgetful, "test_a_good_goal_completes_in_the_state_it_reports"),
    (Forgetful, "test_a_goal_that_the_robot_cannot_do_fails_with_a_reason"),
]


@pytest.mark.parametrize(("flaw", "test"), FLAWS, ids=lambda item: getattr(item, "__name__", item))
async def test_a_flaw_is_found(flaw: type[Lift], test: str) -> None:
    with pytest.raises(AssertionError):
        await prove(suite_of(flaw), test)
    for task in asyncio.all_tasks():
        if task.get_name() in ("left behind", "chat"):
            task.cancel()


class Unfinished(BackendSuite):
    kind = BackendKind("lift", Options, lambda o, h: open_lift(Lift(o, h)))

    def test_its_numbers_have_units(self) -> None:
        """Claim so."""

    @pytest.mark.xfail(reason="the vendor's axes have no unit")
    async def test_its_schemas_are_schemas(self, robot: Robot) -> None:
        """Claim otherwise."""


Unfinished.__test__ = False  # pyright: ignore[reportAttributeAccessIssue]


async def test_what_an_author_leaves_out_or_changes_is_told() -> None:
    suite = Unfinished()
    with pytest.raises(AssertionError, match=r"goals\(\) has none for action/lift.*truth\(\)"):
        await prove(suite, "test_all_that_is_declared_is_proved")
    assert suite.altered(BackendSuite) == ["test_its_numbers_have_units"]


def test_a_transport_is_asked_for_what_it_offers_and_nothing_else() -> None:
    class Plain(TransportSuite):
        offers = frozenset[str]()

        async def connect(self, server: Server, token: str | None, encoding: Encoding) -> Client:
            return MemoryClient(server.client_api, token, encoding)

    assert Plain.test_who_comes_back_gets_what_was_missed_and_nothing_twice is None
    assert Plain.test_a_ping_is_answered is TransportSuite.test_a_ping_is_answered
    altered = [name for name in Plain.altered(TransportSuite) if Plain.applies(name)]
    assert altered == []


async def test_loopback_takes_a_configuration_a_kind_or_an_open_function() -> None:
    kind = suite_of(Lift).kind
    async with loopback(kind, {"start": 4.0}) as client:
        assert (await client.request("read", "/sensor/height"))["body"] == 4.0
    async with loopback(kind.open, Options(3.0), encoding=Encoding.CBOR) as client:
        assert (await client.request("read", "/sensor/height"))["body"] == 3.0
    async with loopback("[anonymous]\nrole = 'admin'\n") as client:
        assert (await client.request("status"))["body"]["backends"] == []
    async with loopback(msgspec.structs.replace(parse("", "test"), transports={})) as client:
        assert (await client.request("ping"))["status"] == "completed"
    with pytest.raises(ConfigError, match="height"):
        async with loopback(kind, {"height": 4.0}):
            pass


async def test_a_served_backend_is_seen_by_several_and_kept_after_its_end() -> None:
    async with serve_backend(suite_of(Lift).kind, tenant="lab", robot="one") as served:
        viewer, admin = served.client(), served.client(ADMIN)
        assert (await viewer.request("read", "/sensor/one/height"))["body"] == 1.0
        done = await admin.request("write", "/param/one/limit", body=5.0)
        assert (done["status"], done["path"]) == ("completed", "/tenant/lab/param/one/limit")
    assert served.life.backend.limit == 5.0  # pyright: ignore[reportAttributeAccessIssue]
