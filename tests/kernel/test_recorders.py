"""What a feature that records hears, and how long replies wait for it."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from kernel.world import BOUND, CONFIG, Client, Robot, prepared
from rcp_gateway.features import active
from rcp_gateway.server import running
from rcp_kernel.config.file import parse
from rcp_kernel.contract.events import Event
from rcp_kernel.errors import QueueFull
from rcp_kernel.features import Call, Feature, FeatureHost, FeatureKind
from rcp_kernel.sessions.command import Command, Record
from rcp_kernel.sessions.session import Answer
from rcp_kernel.wire import Reply

pytestmark = pytest.mark.anyio
OFF = CONFIG + "\n[features]\napprovals = false\naudit = false\n"
GO = {"type": "execute", "path": "/action/go", "body": 2.0}
LIMIT = {"type": "write", "path": "/param/limit", "body": 1.0}
DARK = {"type": "write", "path": "/param/none", "body": 1.0}


class NoKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Nothing to configure."""


class BlackBox:
    """Notes what it hears; as a test says, it has replies wait, refuses, or has a bug."""

    def __init__(self) -> None:
        self.heard: list[str] = []
        self.full = False
        self.feedback = True
        self.broken: frozenset[str] = frozenset()
        """What it cannot take: events and steps of commands by their names, or `everything`."""
        self.holding = asyncio.Event()
        self.kept = asyncio.Event()
        self.kept.set()

    def make(self, _table: NoKeys, _host: FeatureHost) -> Feature:
        return Feature(
            on_event=self.hear,
            on_command=self.follow,
            feedback=self.feedback,
            durability=self,
        )

    def hear(self, event: Event) -> bool:
        self._break(event.what)
        asked = "" if event.request is None else f" by {event.request.id}"
        self.heard.append(f"{event.what} {event.outcome}{asked}")
        return True

    def _break(self, what: str) -> None:
        if self.broken & {what, "everything"}:
            raise ZeroDivisionError

    def follow(self, command: Command, step: Record) -> None:
        self._break(step.status)
        self.heard.append(f"{command.path.rpartition('/')[2]} {step.status}")

    def check(self) -> None:
        if self.full:
            raise QueueFull("the tape is full")

    def send_when_stored(self, send: Answer, until: float, reply: Reply) -> None:
        self.heard.append(f"holds {reply.status}")
        self.holding.set()
        task = asyncio.ensure_future(self.kept.wait())
        task.add_done_callback(lambda _: send(reply))

    def send_estop_when_stored(self, send: Answer, reply: Reply) -> None:
        self.heard.append(f"holds e-stop {reply.status}")
        send(reply)


@asynccontextmanager
async def recorded(box: BlackBox) -> AsyncGenerator[tuple[Client, Robot]]:
    robots: list[Robot] = []
    config = parse(OFF, "test")
    made = prepared(config, robots)
    features = msgspec.structs.replace(config, features={**config.features, "box": True})
    kinds = {"box": FeatureKind("box", NoKeys, box.make)}
    made = msgspec.structs.replace(made, features=active(features, kinds, "test"))
    async with running(made) as server:
        robots[-1].release.set()
        yield Client(server.client_api, "operator-operator"), robots[-1]


async def test_it_hears_commands_writes_refusals_and_stops_in_their_order() -> None:
    box = BlackBox()
    async with recorded(box) as (client, _):
        for envelope in (LIMIT, GO, DARK, {"type": "execute", "path": "/system/estop"}):
            await client.ask(**envelope)
    received = [fact.partition(" by ")[0] for fact in box.heard if not fact.startswith("holds")]
    assert received[0] == "start ok"
    assert received[-1] == "stop ok"
    wanted = ["login ok", "write ok", "go accepted", "go in_progress", "go completed"]
    wanted += ["denial unknown_path", "estop ok"]
    places = [received.index(fact) for fact in wanted]
    assert places == sorted(places)
    assert [fact for fact in box.heard if fact.startswith("write ok by ")] != []


async def test_what_declines_feedback_hears_all_other_steps_and_clients_all() -> None:
    box = BlackBox()
    box.feedback = False
    async with recorded(box) as (client, _):
        id_ = client.send(**GO)
        await client.until(lambda m: m.get("id") == id_ and m.get("status") == "in_progress")
        assert (await client.final(id_))["status"] == "completed"
    assert [fact for fact in box.heard if fact.startswith("go ")] == ["go accepted", "go completed"]


class Drowsy:
    """Cannot say any more whether it has anything to do."""

    broken = False

    @property
    def idle(self) -> bool:
        if self.broken:
            raise ZeroDivisionError
        return True

    def __call__(self, command: Command, step: Record) -> None:
        """Hear a step."""


class DrowsyBox(BlackBox):
    """Hears commands by something that may be idle."""

    def __init__(self) -> None:
        super().__init__()
        self.drowsy = Drowsy()

    def make(self, table: NoKeys, host: FeatureHost) -> Feature:
        return dataclasses.replace(super().make(table, host), on_command=self.drowsy)


async def test_a_feature_that_cannot_say_whether_it_is_idle_keeps_no_reply_back() -> None:
    box = DrowsyBox()
    async with recorded(box) as (client, _):
        assert (await client.ask(**GO))["status"] == "completed"
        box.drowsy.broken = True
        reply = await client.ask(**GO)
        assert reply["error"]["code"] == "queue_full"  # what would not be on record is refused


async def test_all_features_add_to_one_log() -> None:
    hosts: list[FeatureHost] = []

    def make(_table: NoKeys, host: FeatureHost) -> Feature:
        hosts.append(host)
        return Feature()

    config = parse(OFF, "test")
    made = prepared(config, [])
    names = ("one", "two")
    features = msgspec.structs.replace(config, features=dict.fromkeys(names, True))
    kinds = {name: FeatureKind(name, NoKeys, make) for name in names}
    made = msgspec.structs.replace(made, features=active(features, kinds, "test"))
    async with running(made):
        first, second = (host.ledger for host in hosts)
        assert first is second


async def test_a_reply_leaves_when_its_record_is_kept_and_the_robot_does_not_wait() -> None:
    box = BlackBox()
    async with recorded(box) as (client, robot):
        box.kept.clear()
        pending = asyncio.ensure_future(client.ask(**LIMIT))
        async with asyncio.timeout(BOUND):
            await box.holding.wait()
        assert robot.writes
        stopped = await client.ask(type="execute", path="/system/estop")
        assert stopped["status"] == "completed"
        assert not pending.done()
        box.kept.set()
        assert (await pending)["status"] == "completed"
    assert "holds e-stop completed" in box.heard


async def test_what_it_cannot_keep_is_refused_but_never_a_stop() -> None:
    box = BlackBox()
    async with recorded(box) as (client, robot):
        box.full = True
        for envelope in (LIMIT, GO):
            assert (await client.ask(**envelope))["error"]["code"] == "queue_full"
        assert robot.writes == []
        for path in ("/service/hold", "/system/estop"):
            assert (await client.ask(type="execute", path=path))["status"] == "completed"


async def test_what_has_acted_and_could_not_be_recorded_is_not_confirmed() -> None:
    box = BlackBox()
    async with recorded(box) as (client, robot):
        for envelope, broken in ((LIMIT, "write"), (GO, "completed")):
            box.broken = frozenset((broken,))
            reply = await client.ask(**envelope, idempotency_key=broken)
            again = await client.ask(**envelope, idempotency_key=broken)
            for told in (reply, again):
                assert told["error"]["code"] == "deadline_exceeded"
                assert told["error"]["details"] == {"outcome": "completed"}
                assert told["error"]["retryable"] is False
            box.broken = frozenset()
            assert (await client.ask(**envelope))["status"] == "completed"
        assert len(robot.writes) == 2
    assert box.heard.count("unrecorded internal") == 2


async def test_a_command_whose_beginning_could_not_be_recorded_does_not_begin() -> None:
    box = BlackBox()
    async with recorded(box) as (client, robot):
        box.broken = frozenset(("accepted",))
        reply = await client.ask(**GO)
        assert (reply["status"], reply["error"]["code"]) == ("rejected", "queue_full")
        assert robot.started.empty()
        halts = robot.halts
        await client.ask(type="execute", path="/service/hold")
        assert robot.halts > halts


async def test_one_that_takes_nothing_refuses_all_but_stops_until_it_works_again() -> None:
    box = BlackBox()
    async with recorded(box) as (client, robot):
        box.broken = frozenset(("everything",))
        assert (await client.ask(**LIMIT))["error"]["code"] == "deadline_exceeded"
        for envelope in (LIMIT, GO):
            assert (await client.ask(**envelope))["error"]["code"] == "queue_full"
        assert len(robot.writes) == 1
        box.broken = frozenset()
        assert (await client.ask(**LIMIT))["error"]["code"] == "queue_full"  # which it takes
        assert (await client.ask(**LIMIT))["status"] == "completed"
        box.broken = frozenset(("everything",))
        for path in ("/service/hold", "/system/estop"):
            halts = robot.halts
            reply = await client.ask(type="execute", path=path)
            assert robot.halts > halts
        assert reply["status"] == "completed"
        assert "no audit record" in reply["message"]


async def test_what_it_did_not_take_makes_the_gateway_degraded_with_the_reason() -> None:
    box = BlackBox()
    async with recorded(box) as (client, _):
        before = (await client.ask(type="status"))["body"]
        assert (before["state"], before["features"]) == ("ok", [{"name": "box", "state": "ok"}])
        box.broken = frozenset(("write",))
        await client.ask(**LIMIT)
        box.broken = frozenset()
        after = (await client.ask(type="status"))["body"]
        assert after["state"] == "degraded"
        [state] = after["features"]
        assert (state["name"], state["state"], state["faults"]) == ("box", "degraded", 1)
        assert "ZeroDivisionError" in state["detail"]


class Bystander(BlackBox):
    """The same box when replies do not wait for it."""

    def make(self, _table: NoKeys, _host: FeatureHost) -> Feature:
        return Feature(on_event=self.hear, on_command=self.follow, observer=self._observer())

    @staticmethod
    def _observer() -> Any:
        def broken(*_: Any) -> None:
            raise ZeroDivisionError

        names = ("sent", "took", "refused", "stopping", "rested")
        return SimpleNamespace(writes_only=False, **dict.fromkeys(names, broken))


async def test_a_bug_in_one_that_keeps_no_record_is_told_and_changes_nothing() -> None:
    box = Bystander()
    async with recorded(box) as (client, robot):
        box.broken = frozenset(("everything",))
        for envelope in (LIMIT, GO, {"type": "execute", "path": "/system/estop"}):
            assert (await client.ask(**envelope))["status"] == "completed"
        assert robot.writes
        reply = (await client.ask(type="status"))["body"]
        assert (reply["state"], reply["features"][0]["state"]) == ("degraded", "degraded")


class Dozing(BlackBox):
    """A box that is called for some commands alone, and observes writes alone."""

    def __init__(self) -> None:
        super().__init__()
        self.idle = False
        self.observed: list[str] = []

    def make(self, _table: NoKeys, _host: FeatureHost) -> Feature:
        nothing = dict.fromkeys(("took", "refused", "stopping", "rested"), lambda *_: None)
        observer: Any = SimpleNamespace(sent=self._sent, writes_only=True, **nothing)
        return Feature(on_command=self, observer=observer)

    def _sent(self, call: Call) -> None:
        self.observed.append(call.request.type)

    def __call__(self, command: Command, step: Record) -> None:
        self.heard.append(step.status)
        self.idle = step.status == "accepted"


async def test_one_that_has_nothing_to_do_is_not_called() -> None:
    box = Dozing()
    async with recorded(box) as (client, _):
        for envelope in (GO, LIMIT, GO):
            assert (await client.ask(**envelope))["status"] == "completed"
        assert box.heard == ["accepted"]
        assert box.observed == ["write"]
        box.idle = False
        await client.ask(**GO)
        assert box.heard == ["accepted", "accepted"]


async def test_a_gateway_without_the_audit_log_keeps_no_record_and_has_no_trace_of_it() -> None:
    box = BlackBox()
    async with recorded(box) as (client, _):
        reply: dict[str, Any] = await client.ask(type="read", path="/system/audit")
        assert reply["error"]["code"] == "unknown_path"
        assert "record" not in (await client.ask(type="status"))["body"]
