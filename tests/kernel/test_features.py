"""Features: which are there, in which order their guards are asked, and what none of them can do."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest
from structlog.testing import capture_logs

from kernel.world import BOUND, CONFIG, Client, Robot, World, prepared, world_of
from offering import offer
from rcp_gateway.features import ActiveFeature, active, make
from rcp_gateway.server import prepare, running
from rcp_kernel.config.features import BUILTIN
from rcp_kernel.config.file import load, parse
from rcp_kernel.errors import ConfigError, Forbidden, PluginError
from rcp_kernel.features import Call, Feature, FeatureHost, FeatureKind, Guard, Slot
from rcp_kernel.features.approval import APPROVALS
from rcp_kernel.types import Twist
from rcpd.reload import reload

pytestmark = pytest.mark.anyio
OFF = "\n[features]\n" + "".join(f"{name} = false\n" for name in BUILTIN)
NONE = CONFIG + OFF
ASKS = '\n[roles.asks]\nallow = []\napprove = ["/action/go"]\n'


class NoKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Nothing to configure."""


class Noting(Guard):
    """A guard that notes when it is asked, and does what a test says."""

    def __init__(self, name: str, slot: Slot, noted: list[str]) -> None:
        self.name, self.slot, self.noted = name, slot, noted
        self.act: Callable[[Call], None] = lambda _call: None

    def admit(self, call: Call) -> None:
        self.noted.append(f"{self.name} admits {call.entry.path}")
        self.act(call)

    def confirm(self, call: Call) -> None:
        self.noted.append(f"{self.name} confirms {call.entry.path}")


def kind_of(guard: Noting) -> FeatureKind:
    def make(_table: NoKeys, _host: FeatureHost) -> Feature:
        return Feature(guard=guard)

    return FeatureKind(guard.name, NoKeys, make)


async def guarded(guards: Sequence[Noting], *requests: dict[str, Any]) -> list[dict[str, Any]]:
    """Send requests to a gateway with some guards, and return the final replies."""
    robots: list[Robot] = []
    config = parse(NONE, "test")
    made = prepared(config, robots)
    kinds = {guard.name: kind_of(guard) for guard in guards}
    features = msgspec.structs.replace(
        config, features=dict.fromkeys(kinds, True) | dict.fromkeys(BUILTIN, False)
    )
    made = msgspec.structs.replace(made, features=active(features, kinds, "test"))
    async with running(made) as server:
        client = Client(server.client_api, "operator-operator")
        robots[-1].release.set()
        replies = [await client.ask(**request) for request in requests]
        replies.append({"writes": list(robots[-1].writes)})
        return replies


LIMIT = {"type": "write", "path": "/param/limit", "body": 1.0}
DRIVE = {"type": "write", "path": "/actuator/drive", "body": {"linear": {"x": 1.0}}}


async def test_a_gateway_without_any_feature_serves_and_stops_robots() -> None:
    async with world_of(NONE) as world:
        client, robot = world.client(), world.robot
        assert world.server.client_api.service(APPROVALS) is None
        assert (await client.ask(type="read", path="/param/limit"))["body"] == 1.5
        assert (await client.ask(**LIMIT))["status"] == "completed"
        assert await completes(world, client, "/action/go", 2.0)
        halts = robot.halts
        assert await completes(world, client, "/service/hold", {})
        assert robot.halts > halts
        assert (await client.ask(type="execute", path="/system/estop", body={}))["body"]["active"]
        refused = await client.ask(type="execute", path="/action/go", body=2.0)
        assert refused["error"]["code"] == "estop_active"
        admin = world.client("admin-admin-admin")
        for name in ("approvals", "leases", "plans"):
            reply = await admin.ask(type="read", path=f"/system/{name}")
            assert reply["error"]["code"] == "unknown_path"


async def test_a_gateway_without_any_feature_stops_what_a_lost_client_drove() -> None:
    async with world_of(NONE) as world:
        client, other = world.client(), world.client()
        assert (await client.ask(**DRIVE))["status"] == "completed"
        id_ = other.send(type="subscribe", path="/actuator/drive")
        client.connection.close()
        await other.until(
            lambda m: m["type"] == "update" and m["id"] == id_ and m["body"]["linear"]["x"] == 0
        )
        assert world.robot.writes[-1] == ("actuator/drive", Twist())
        assert (await other.ask(**DRIVE))["status"] == "completed"


async def completes(world: World, client: Client, path: str, body: Any) -> bool:
    world.robot.release.set()
    return (await client.ask(type="execute", path=path, body=body))["status"] == "completed"


async def test_guards_are_asked_by_slot_then_by_name_when_it_comes_in_and_when_it_acts() -> None:
    noted: list[str] = []
    guards = [
        Noting("zone", Slot.LEASE, noted),
        Noting("asks", Slot.APPROVAL, noted),
        Noting("hours", Slot.POLICY, noted),
        Noting("doors", Slot.POLICY, noted),
    ]
    await guarded(guards, LIMIT)
    path = "/tenant/alpha/param/limit"
    order = ("zone", "doors", "hours", "asks")
    assert noted == [f"{name} {when} {path}" for when in ("admits", "confirms") for name in order]


async def test_a_guard_that_is_not_active_is_not_asked_and_nobody_asks_one_about_a_stop() -> None:
    noted: list[str] = []
    idle, wakeful = Noting("idle", Slot.POLICY, noted), Noting("wakeful", Slot.POLICY, noted)
    idle.active = False
    await guarded(
        [idle, wakeful],
        {"type": "write", "path": "/actuator/drive", "body": {}},
        {"type": "execute", "path": "/service/hold"},
        {"type": "execute", "path": "/system/estop", "body": {}},
        {"type": "read", "path": "/param/limit"},
    )
    assert noted == []
    await guarded([idle, wakeful], LIMIT)
    assert len(noted) == 2
    assert all("wakeful" in one for one in noted)


async def test_who_has_control_is_asked_about_a_safe_value_and_not_about_a_hold_or_estop() -> None:
    noted: list[str] = []
    zone = Noting("zone", Slot.LEASE, noted)
    stops: tuple[dict[str, Any], ...] = (
        {"type": "execute", "path": "/service/hold"},
        {"type": "execute", "path": "/system/estop", "body": {}},
    )
    await guarded([zone], *stops)
    assert noted == []

    def refuse(call: Call) -> None:
        raise Forbidden("booked", path=call.entry.path)

    zone.act = refuse
    rest = {"type": "write", "path": "/actuator/drive", "body": {}}
    refused, *_, robot = await guarded([zone], rest, *stops)
    assert refused["error"]["message"] == "booked"
    assert robot["writes"] == []


async def test_a_listener_with_a_bug_keeps_neither_a_session_nor_a_stop_from_its_end() -> None:
    received: list[str] = []

    def listening(name: str) -> FeatureKind:
        def hear(what: str, *_: object) -> None:
            received.append(f"{name} {what}")
            if name == "broken":
                raise ZeroDivisionError(what)

        def make(_table: NoKeys, _host: FeatureHost) -> Feature:
            return Feature(
                session_ended=partial(hear, "session"),
                rights_changed=partial(hear, "rights"),
                halted=partial(hear, "halted"),
            )

        return FeatureKind(name, NoKeys, make)

    kinds = {name: listening(name) for name in ("broken", "sound")}
    config = parse(NONE, "test")
    features = {**dict.fromkeys(kinds, True), **dict.fromkeys(BUILTIN, False)}
    wanted = msgspec.structs.replace(config, features=features)
    made = prepared(config, [])
    made = msgspec.structs.replace(made, features=active(wanted, kinds, "test"))
    async with running(made) as server:
        client, other = (Client(server.client_api, "operator-operator") for _ in range(2))
        with capture_logs() as said:
            other.connection.close()
            server.gateway.sessions.review()
            reply = await client.ask(type="execute", path="/system/estop", body={})
        assert reply["body"]["active"]
        what = ("session", "rights", "halted")
        assert received == [f"{name} {one}" for one in what for name in kinds]
        assert [one["feature"] for one in said if one["event"] == "feature_failed"] == [
            "broken"
        ] * 3


async def test_a_follower_of_robots_with_a_bug_keeps_no_robot_from_being_stopped() -> None:
    robots: list[Robot] = []
    config = parse(NONE, "test")

    def make(_table: NoKeys, host: FeatureHost) -> Feature:
        def fails(*_facts: Any) -> None:
            raise ZeroDivisionError

        host.robots.follow(fails, fails)
        host.robots.follow_state(fails)
        return Feature()

    features = msgspec.structs.replace(
        config, features={"bug": True} | dict.fromkeys(BUILTIN, False)
    )
    made = active(features, {"bug": FeatureKind("bug", NoKeys, make)}, "test")
    made = msgspec.structs.replace(prepared(config, robots), features=made)
    async with running(made) as server:
        robot, client = robots[-1], Client(server.client_api, "operator-operator")
        assert (await client.ask(**DRIVE, valid_for=BOUND))["status"] == "completed"
        halts = robot.halts
        stopped = await client.ask(type="execute", path="/system/estop", body={})
        assert robot.halts > halts
        assert (stopped["status"], robot.moving) == ("completed", set())
        robot.remove("sensor/level")
        gone = await client.ask(type="read", path="/sensor/level")
        assert gone["error"]["code"] == "unknown_path"


async def test_a_guard_with_a_bug_refuses_and_the_robot_is_left_alone() -> None:
    broken = Noting("broken", Slot.POLICY, [])

    def stumble(_call: Call) -> None:
        raise ZeroDivisionError

    broken.act = stumble
    refused, robot = await guarded([broken], LIMIT)
    assert refused["error"]["code"] == "internal"
    assert refused["error"]["trace_id"]
    assert robot["writes"] == []


async def test_a_later_guard_is_not_asked_about_what_an_earlier_one_refuses() -> None:
    noted: list[str] = []
    strict, asks = Noting("strict", Slot.POLICY, noted), Noting("asks", Slot.APPROVAL, noted)

    def refuse(call: Call) -> None:
        raise Forbidden("closed", path=call.entry.path)

    strict.act = refuse
    refused, _ = await guarded([asks, strict], LIMIT)
    assert refused["error"]["message"] == "closed"
    assert noted == ["strict admits /tenant/alpha/param/limit"]


# -- which are there -------------------------------------------------------------------------------

QUIET = "transports = {asgi = false, http = false, ws = false, sse = false}\n"


def test_a_feature_that_the_configuration_uses_cannot_be_taken_out() -> None:
    with pytest.raises(ConfigError, match="approvals = false, but the configuration uses"):
        parse(QUIET + ASKS + "[features]\napprovals = false\naudit = false\n", "f")


def offered(monkeypatch: pytest.MonkeyPatch, folder: Path, **sources: str) -> None:
    """Have these modules, and nothing else, be the installed features."""
    for name, text in sources.items():
        (folder / f"{name}.py").write_text(text)
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(str(folder))
    offer(monkeypatch, [EntryPoint(name, name, "rcp.features") for name in sources])


def test_a_built_in_feature_that_is_not_installed_is_missed_only_where_it_is_used(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    offered(monkeypatch, tmp_path)
    assert prepare(parse(QUIET, "f"), "f").features == ()
    with pytest.raises(PluginError, match="'approvals', which cannot be loaded: not installed"):
        prepare(parse(QUIET + ASKS, "f"), "f")


@pytest.mark.parametrize(
    "source",
    [
        "raise SystemExit",
        "import no_such_library",
        "from rcp_gateway.hookspecs import hookimpl\n@hookimpl\ndef rcp_features(): return [1 / 0]",
    ],
)
def test_a_feature_that_cannot_be_loaded_stops_the_start(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, source: str
) -> None:
    offered(monkeypatch, tmp_path, doors=source)
    with pytest.raises(PluginError, match="the feature 'doors', which cannot be loaded"):
        prepare(parse(QUIET + "[features.doors]\n", "f"), "f")


def test_a_feature_of_others_is_loaded_only_where_it_has_a_table(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    offered(monkeypatch, tmp_path, loud="raise SystemExit('imported')")
    prepare(parse(QUIET, "f"), "f")


def test_a_feature_whose_keys_are_elsewhere_has_no_table_of_its_own() -> None:
    with pytest.raises(ConfigError, match=r"\[features.approvals\] takes no keys"):
        prepare(parse(QUIET + "[features.approvals]\nttl = 3\n", "f"), "f")


async def test_a_feature_lives_from_before_the_robots_until_after_them() -> None:
    from contextlib import asynccontextmanager

    robots: list[Robot] = []
    seen: list[str] = []

    @asynccontextmanager
    async def live() -> Any:
        seen.append(f"in, {len(robots)} robots")
        yield
        seen.append("out")

    def make(_table: NoKeys, _host: FeatureHost) -> Feature:
        return Feature(running=live)

    kind = FeatureKind("lives", NoKeys, make)
    config = parse(NONE, "test")
    features = {"lives": True, **dict.fromkeys(BUILTIN, False)}
    wanted = msgspec.structs.replace(config, features=features)
    made = prepared(config, robots)
    made = msgspec.structs.replace(made, features=active(wanted, {"lives": kind}, "test"))
    async with running(made):
        await asyncio.sleep(0)
        assert seen == ["in, 0 robots"]
    assert seen == ["in, 0 robots", "out"]


async def test_a_reload_changes_the_keys_of_features_and_neither_adds_nor_removes_one(
    tmp_path: Path,
) -> None:
    file = tmp_path / "rcp.toml"
    file.write_text(QUIET)
    async with running(prepare(load(file), str(file))) as server:
        admission = server.gateway.admission
        assert admission.other_guards == ()
        file.write_text(QUIET + ASKS)
        await reload(server, file)
        assert len(admission.other_guards) == 1
        file.write_text(QUIET + "[features]\napprovals = false\naudit = false\n")
        with capture_logs() as said:
            await reload(server, file)
        assert {"part": "features"}.items() <= said[0].items()
        assert admission.other_guards == ()
        assert server.client_api.service(APPROVALS) is not None


class Former:
    """A guard as they were before `Guard` declared `idle`."""

    slot = Slot.POLICY
    active = True

    def admit(self, call: Call) -> None: ...
    def confirm(self, call: Call) -> None: ...


def test_a_guard_that_lacks_what_is_read_of_it_says_so_at_the_start() -> None:
    def former(_table: NoKeys, _host: FeatureHost) -> Feature:
        return Feature(guard=Former())  # pyright: ignore[reportArgumentType] - what is refused

    kind = FeatureKind("former", NoKeys, former)
    with pytest.raises(PluginError, match=r"'former' has no `idle`; derive it from `.*\.Guard`"):
        make([ActiveFeature(kind, NoKeys())], lambda _: cast("FeatureHost", None))
