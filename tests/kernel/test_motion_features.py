"""What a feature that watches over motion hears of robots, says of them, and can do to them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import pytest

from configuration import key, role, rule
from kernel.world import BOUND, CONFIG, Client, Robot, World, prepared
from rcp_conditions import condition
from rcp_gateway.features import active
from rcp_gateway.server import running
from rcp_kernel.access.acl import Rights
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ModeForbids
from rcp_kernel.features import (
    Call,
    CommandObserver,
    Feature,
    FeatureHost,
    FeatureKind,
    Guard,
    Slot,
    StatusPart,
)
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample

pytestmark = pytest.mark.anyio
DRIVE = "/tenant/alpha/actuator/drive"
LEVEL = "/tenant/alpha/sensor/level"
GO = {"type": "write", "path": "/actuator/drive", "body": {"linear": {"x": 1.0}}}
REST = {**GO, "body": {}}


class NoKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Nothing to configure."""


class Zone(Guard, CommandObserver):
    """A feature with all that one may have which watches over motion."""

    slot = Slot.MOTION_LIMIT

    def __init__(self, host: FeatureHost) -> None:
        self.host = host
        self.closed = False
        self.broken = False
        self.heard: list[tuple[str, str]] = []
        self._more = asyncio.Event()

    def hear(self, what: str, entry: Entry) -> None:
        self.heard.append((what, entry.path))
        self._more.set()
        if self.broken:
            raise ZeroDivisionError

    async def until(self, what: str) -> None:
        async with asyncio.timeout(BOUND):
            while not any(heard == what for heard, _ in self.heard):
                self._more.clear()
                await self._more.wait()

    def admit(self, call: Call) -> None:
        if self.closed:
            raise ModeForbids("the zone is closed", path=call.entry.path)

    def confirm(self, call: Call) -> None:
        self.admit(call)

    def foresee(self, _session: Session, entry: Entry, value: Any) -> None:
        if value == 12.0:
            raise ModeForbids("never twelve", path=entry.path)

    def describe(self, _rights: Rights, entry: Entry, /, *, schemas: bool) -> dict[str, Any]:
        return {"zone": entry.name, "wide": schemas}

    def status(self, _rights: Rights | None) -> StatusPart:
        if self.broken:
            raise ZeroDivisionError
        return StatusPart({"zone": "shut"}, degraded=self.closed)

    def sent(self, call: Call) -> None:
        self.hear("sent", call.entry)

    def took(self, entry: Entry, value: Any, actual: Any) -> None:
        assert value is actual
        self.hear("took", entry)

    def refused(self, entry: Entry, value: Any) -> None:
        self.hear("refused", entry)

    def stopping(self, entry: Entry, safe: Any) -> None:
        self.hear("stopping", entry)

    def rested(self, entry: Entry, safe: Any) -> None:
        self.hear("rested", entry)


class ZonedWorld(World):
    """A gateway with the feature."""

    zone: Zone


@asynccontextmanager
async def zoned(text: str = CONFIG) -> AsyncGenerator[ZonedWorld]:
    made: list[Zone] = []

    def make(_table: NoKeys, host: FeatureHost) -> Feature:
        zone = Zone(host)
        made.append(zone)
        return Feature(
            guard=zone,
            observer=zone,
            foresee=zone.foresee,
            describe=zone.describe,
            status=zone.status,
        )

    robots: list[Robot] = []
    config = parse(text, "test")
    kinds = {"zone": FeatureKind("zone", NoKeys, make)}
    ready = prepared(config, robots)
    wanted = msgspec.structs.replace(config, features={"zone": True})
    features = (*ready.features, *active(wanted, kinds, "test"))
    ready = msgspec.structs.replace(ready, features=features)
    async with running(ready) as server:
        world = ZonedWorld(server, robots)
        world.zone = made[-1]
        yield world


async def test_it_hears_what_is_sent_and_taken_and_how_a_robot_comes_to_rest() -> None:
    async with zoned() as world:
        client, zone = world.client(), world.zone
        assert (await client.ask(**GO))["status"] == "completed"
        await zone.until("rested")
        assert [what for what, _ in zone.heard] == ["sent", "took", "stopping", "rested"]
        assert {path for _, path in zone.heard} == {DRIVE}


async def test_it_hears_of_what_no_guard_is_asked_about() -> None:
    async with zoned() as world:
        client, zone = world.client(), world.zone
        zone.closed = True
        assert (await client.ask(**GO))["error"]["code"] == "mode_forbids"
        assert zone.heard == []
        assert (await client.ask(**REST))["status"] == "completed"
        assert [what for what, _ in zone.heard] == ["sent", "took"]


async def test_it_hears_of_a_write_that_the_robot_refuses() -> None:
    async with zoned() as world:
        world.robot.fail_writes = 1
        assert (await world.client().ask(**GO))["error"]["code"] == "device_rejected"
        assert [what for what, _ in world.zone.heard] == ["sent", "refused"]


async def test_an_observer_that_fails_keeps_no_command_and_no_stop_from_a_robot() -> None:
    async with zoned() as world:
        client, zone = world.client(), world.zone
        zone.broken = True
        assert (await client.ask(**GO))["status"] == "completed"
        await zone.until("rested")
        assert world.robot.writes[-1][1] == world.robot.writes[-1][1].__class__()
        assert (await client.ask(type="execute", path="/system/estop", body={}))["body"]["active"]


@pytest.mark.parametrize("slot", Slot)
async def test_an_idle_guard_is_not_called_until_it_is_idle_no_more(
    slot: Slot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Zone, "slot", slot)
    async with zoned() as world:
        client, zone = world.client(), world.zone
        zone.idle = zone.closed = True
        running = client.send(type="execute", path="/action/wait_in_line", body=1)
        waiting = client.send(type="execute", path="/action/wait_in_line", body=2)
        async with asyncio.timeout(BOUND):
            await world.robot.started.get()
        zone.idle = False  # from here on, whether a command is new or has waited
        assert (await client.ask(**GO))["error"]["code"] == "mode_forbids"
        world.robot.release.set()
        assert (await client.final(running))["status"] == "completed"
        assert (await client.final(waiting))["error"]["code"] == "mode_forbids"
        zone.idle = True
        assert (await client.ask(**GO))["status"] == "completed"


async def test_a_feature_whose_guard_is_not_active_hears_nothing() -> None:
    async with zoned() as world:
        kernel, zone = world.server.gateway, world.zone
        zone.active = False
        kernel.reconfigure(kernel.settings.config)
        assert (await world.client().ask(**GO))["status"] == "completed"
        assert zone.heard == []


async def test_a_guard_for_motion_is_asked_before_the_quota() -> None:
    quota = role("few", rule("execute", "/**"), quota={"commands": 1})
    quota += key("few", "few-few-few-few-few")
    async with zoned(CONFIG + quota) as world:
        client, zone = world.client("few-few-few-few-few"), world.zone
        client.send(type="execute", path="/action/go", body=2.0)
        await world.robot.started.get()
        echo = {"type": "execute", "path": "/service/echo", "body": "x"}
        zone.closed = True
        assert (await client.ask(**echo))["error"]["code"] == "mode_forbids"
        zone.closed = False
        assert (await client.ask(**echo))["error"]["code"] == "queue_full"


async def test_a_plan_is_refused_for_what_could_never_pass() -> None:
    async with zoned() as world:
        client = world.client()
        plan = {"steps": [{"do": "execute", "path": "/action/go", "value": 12.0}]}
        reply = await client.ask(type="execute", path="/system/plans", body=plan)
        assert reply["error"]["code"] == "mode_forbids"
        assert world.robot.started.empty()


async def test_discovery_and_the_report_of_health_tell_what_it_says() -> None:
    async with zoned() as world:
        client, zone = world.client(), world.zone

        async def described(path: str, *, schemas: bool) -> dict[str, Any]:
            reply = await client.ask(type="discover", path=path, body={"schemas": schemas})
            return reply["body"]["resources"][0]

        drive = await described("/actuator/drive", schemas=True)
        assert (drive["zone"], drive["wide"]) == ("actuator/drive", True)
        assert (await described("/actuator/drive", schemas=False))["wide"] is False
        assert "zone" not in await described("/sensor/level", schemas=True)
        assert await health(client) == ("ok", "shut")
        zone.closed = True
        assert await health(client) == ("degraded", "shut")
        zone.broken = True
        assert await health(client) == ("degraded", None)


async def health(client: Client) -> tuple[str, str | None]:
    report = (await client.ask(type="read", path="/system/status"))["body"]
    return report["state"], report.get("zone")


async def test_it_watches_a_path_that_comes_and_goes_until_it_ends_that() -> None:
    async with zoned() as world:
        robots, host = world.zone.host.robots, world.robot.host
        seen: list[float] = []

        def offer(sample: Sample) -> None:
            seen.append(sample.value)
            raise ZeroDivisionError

        end = robots.watch(LEVEL, offer)
        host.publish("sensor/level", 1.0)
        await until(lambda: seen == [1.0])
        resource = robots.entries[LEVEL].resource
        host.withdraw("sensor/level")
        host.declare(resource)
        host.publish("sensor/level", 2.0)
        await until(lambda: seen == [1.0, 2.0])
        end()
        host.publish("sensor/level", 3.0)
        entry = robots.entries[LEVEL]
        await until(lambda: entry.latest is not None and entry.latest.value == 3.0)
        assert seen == [1.0, 2.0]


async def until(good: Callable[[], bool]) -> None:
    async with asyncio.timeout(BOUND):
        while not good():  # noqa: ASYNC110 - nobody tells
            await asyncio.sleep(0)


async def test_it_stops_an_actuator_and_cancels_what_runs() -> None:
    async with zoned() as world:
        client, zone = world.client(), world.zone
        robots = zone.host.robots
        assert (await client.ask(**GO, valid_for=100))["status"] == "completed"
        control = zone.host.control
        control.stop(robots.entries["/tenant/alpha/param/limit"])  # has no safe value
        control.stop(robots.entries[DRIVE])
        await zone.until("rested")
        assert [name for name, _ in world.robot.writes] == ["actuator/drive"] * 2
        moving = client.send(type="execute", path="/action/go", body=2.0)
        await world.robot.started.get()
        assert list(control.running(DRIVE)) == []
        (command,) = control.running("/tenant/alpha/action/go")
        assert command.requester is client.connection.session
        control.cancel(command, "left its zone")
        assert "left its zone" in (await client.final(moving))["message"]


async def test_it_asks_for_the_state_of_a_robot_and_tells_its_driver() -> None:
    async with zoned() as world:
        client, zone = world.client(), world.zone
        robots = zone.host.robots
        high = condition("sensor.level > 1.0")
        robots.conditions.use([high])
        entry = robots.entries[DRIVE]
        assert robots.conditions.holds(high, entry) is None
        world.robot.host.publish("sensor/level", 2.0)
        await until(lambda: robots.conditions.holds(high, entry) is True)
        session = client.connection.session
        assert session is not None
        zone.host.sessions.tell(session.holder, "zone_left", path=DRIVE)
        assert (await client.notice("zone_left"))["path"] == DRIVE
