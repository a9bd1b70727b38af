"""Triggers fire as their conditions say, with the rights of whoever made them, and on record."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
import pytest

from configuration import table
from plugins.triggers.gateway import (
    ADMIN,
    ALARMS,
    FIRINGS,
    LIMITED,
    OTHER,
    TRIGGERS,
    Rig,
    gateway,
    webhook,
)
from rcp_gateway.testing import SteppedClock
from rcp_triggers.alarms import Alarms
from rcp_triggers.outbox import Outbox

pytestmark = pytest.mark.anyio


def code(reply: dict[str, Any]) -> str | None:
    return reply.get("error", {}).get("code")


async def test_it_fires_when_its_condition_has_held_and_clears_by_another(
    stepped: SteppedClock,
) -> None:
    async with gateway(clock=stepped.clock) as rig:
        await rig.follow()
        robot = rig.robot()
        robot.measure("sensor/battery", 50.0)
        await rig.made(clear="sensor.battery > 30", alarm=True, **{"for": 100})
        robot.measure("sensor/battery", 10.0)
        pending = await rig.eventually(lambda: _in_state(rig, "pending"))
        assert pending["condition"] == "true"
        stepped.advance(200)
        fired = await rig.happened("fired")
        assert (fired["robot"], fired["values"]) == ("/tenant/alpha", {"sensor.battery": 10.0})
        assert fired["by"] == "operator"
        robot.measure("sensor/battery", 25.0)  # between both
        await rig.eventually(lambda: _is(rig, condition="false", state="active"))
        robot.measure("sensor/battery", 40.0)
        assert (await rig.happened("cleared"))["values"] == {"sensor.battery": 40.0}


async def _in_state(rig: Rig, state: str) -> dict[str, Any] | None:
    return await _is(rig, state=state)


async def _is(rig: Rig, **facts: Any) -> dict[str, Any] | None:
    found = await rig.on_robot()
    return found if all(found.get(name) == fact for name, fact in facts.items()) else None


async def test_what_is_not_known_is_unknown_with_the_reason(stepped: SteppedClock) -> None:
    async with gateway(clock=stepped.clock) as rig:
        rig.robot().measure("sensor/name", "rover")
        rig.robot().measure("sensor/heat", 20.0)
        cases = {
            "sensor.battery < 20": "there is no value yet",
            "sensor.heat > 50": "the value is stale",
            "sensor.name > 5": "do not have the types",
            "sensor.name.first == 'a'": "no such field",
        }
        for number, when in enumerate(cases):
            await rig.made(name=f"n{number}", when=when, alarm=True)
        stepped.advance(30)  # the heat is overdue
        for number, why in enumerate(cases.values()):

            async def known(name: str = f"n{number}") -> dict[str, Any] | None:
                row = await rig.on_robot(name)
                return row if row["condition"] == "unknown" else None

            row = await rig.eventually(known)
            assert why in str(row["unknown"]), row
            assert row["state"] == "clear"
        assert await rig.alarms() == []
        rig.robot().lose()
        status = (await rig.admin.request("read", "/system/status"))["body"]["triggers"]
        assert status["robots"] == {"unknown": 4}


async def test_an_alarm_is_open_until_it_has_cleared_and_was_acknowledged() -> None:
    async with gateway() as rig:
        await rig.follow()
        await rig.made(alarm=True, severity="critical", message="Battery is low")
        rig.robot().measure("sensor/battery", 10.0)
        fired = await rig.happened("fired")
        (alarm,) = await rig.alarms()
        assert (alarm["alarm"], alarm["state"], alarm["severity"]) == (
            fired["alarm"],
            "active",
            "critical",
        )
        other = rig.client(OTHER)
        assert await rig.alarms(other) == []
        body = {"acknowledge": alarm["alarm"], "comment": "on my way"}
        assert code(await other.request("execute", ALARMS, body=body)) == "unknown_path"
        dry = await rig.operator.request("execute", ALARMS, body=body, dry_run=True)
        assert dry["status"] == "completed", dry
        assert (await rig.alarms())[0]["state"] == "active"
        reply = await rig.operator.request("execute", ALARMS, body=body)
        assert reply["body"]["state"] == "acknowledged"
        assert (reply["body"]["by"], reply["body"]["comment"]) == ("operator", "on my way")
        assert code(await rig.operator.request("execute", ALARMS, body=body)) == "mode_forbids"
        rig.robot().measure("sensor/battery", 90.0)
        await rig.happened("cleared")
        assert (await rig.alarms())[0]["state"] == "closed"
        rig.robot().measure("sensor/battery", 10.0)
        second = await rig.happened("fired")
        assert second["alarm"] != fired["alarm"]
        rig.robot().measure("sensor/battery", 90.0)
        await rig.happened("cleared")
        assert [one["state"] for one in await rig.alarms()] == ["cleared", "closed"]


async def test_its_command_has_the_rights_that_its_maker_has_now() -> None:
    async with gateway() as rig:
        await rig.follow()
        await rig.made(execute={"path": "/action/dock", "value": 3.0})
        rig.robot().measure("sensor/battery", 10.0)
        ended = await rig.happened("command")
        assert (ended["outcome"], rig.robot().ran) == ("completed", [("action/dock", 3.0)])
        commands = (await rig.admin.request("read", "/system/commands"))["body"]
        assert commands[0]["principal"] == "operator"

        kernel = rig.served.server.gateway
        config = kernel.settings.config
        keys = tuple(one for one in config.keys if one.name != "operator")
        kernel.reconfigure(msgspec.structs.replace(config, keys=keys), ())
        stopped = await rig.happened("stopped")
        assert "no longer valid" in stopped["detail"]
        rig.robot().measure("sensor/battery", 90.0)
        rig.robot().measure("sensor/battery", 10.0)
        assert "no longer valid" in (await rig.row())["stopped"]
        kernel.reconfigure(config, ())
        await rig.happened("resumed")
        assert rig.robot().ran == [("action/dock", 3.0)]


async def test_a_command_that_is_refused_is_told() -> None:
    async with gateway() as rig:
        await rig.follow()
        await rig.made(execute={"path": "/action/dock", "value": 3.0})
        await rig.admin.request("execute", "/system/estop", body={})
        rig.robot().measure("sensor/battery", 10.0)
        ended = await rig.happened("command")
        assert ended["outcome"] == "estop_active"
        assert (await rig.on_robot())["outcome"] == "estop_active"
        assert rig.robot().ran == []


async def test_what_its_command_was_answered_is_told_to_its_maker_alone() -> None:
    async with gateway() as rig:
        await rig.follow()
        await rig.made(execute={"path": "/action/dock", "value": 3.0})
        await rig.admin.request("execute", "/system/estop", body={"reason": "a secret reason"})
        rig.robot().measure("sensor/battery", 10.0)
        ended = await rig.happened("command")
        assert ended["outcome"] == "estop_active"
        assert "secret" not in str(ended)
        own = (await rig.row(client=rig.operator))["robots"][0]
        assert "a secret reason" in own["detail"]
        assert "secret" not in str(await rig.row())
        tested = await rig.admin.request("execute", TRIGGERS, body={"test": "low"})
        assert tested["body"]["robots"][0]["refused"] == "estop_active"


@pytest.mark.parametrize("part", ["alarm", "outbox"])
async def test_its_command_goes_even_if_the_rest_of_it_fails(
    part: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise OSError(28, "no space left")

    if part == "alarm":
        monkeypatch.setattr(Alarms, "fired", broken)
    else:
        monkeypatch.setattr(Outbox, "add", broken)
    target = table("features.triggers.targets.hook", **webhook("http://127.0.0.1:9/"))
    async with gateway(target) as rig:
        await rig.follow()
        stop = {"path": "/system/estop", "value": {}}
        await rig.made(execute=stop, alarm=True, notify=["hook"])
        rig.robot().measure("sensor/battery", 10.0)
        assert (await rig.happened("command"))["outcome"] == "completed"


async def test_the_name_of_a_hidden_trigger_is_free() -> None:
    rules = table(
        "features.triggers.rules.low", robot="/tenant/beta", when="sensor.battery < 20", alarm=True
    )
    async with gateway(rules) as rig:
        assert [one["trigger"] for one in (await rig.admin.request("read", TRIGGERS))["body"]] == [
            "low"
        ]
        await rig.made(alarm=True)
        removal = {"remove": "low"}
        assert (await rig.operator.request("execute", TRIGGERS, body=removal))[
            "status"
        ] == "completed"


async def test_it_may_stop_a_robot_but_never_reset_the_stop() -> None:
    async with gateway() as rig:
        await rig.follow()
        stop = {"path": "/system/estop", "value": {"scope": "/tenant/alpha"}}
        await rig.made(rig.admin, execute=stop)
        rig.robot().measure("sensor/battery", 10.0)
        assert (await rig.happened("command"))["outcome"] == "completed"
        assert (await rig.admin.request("read", "/system/estop"))["body"]["robots"]
        reset = {"scope": "/tenant/alpha", "reset": True}
        refused = await rig.add(
            rig.admin, name="again", execute={"path": "/system/estop", "value": reset}
        )
        assert code(refused) == "invalid_value"
        step = {"do": "execute", "path": "/system/estop", "value": reset}
        hidden = {"path": "/system/plans", "value": {"steps": [step]}}
        await rig.made(rig.admin, name="again", execute=hidden)
        ended = await rig.happened("command")
        assert ended["outcome"] == "forbidden", ended
        assert (await rig.admin.request("read", "/system/estop"))["body"]["robots"]


async def test_one_that_changes_its_own_condition_is_limited_and_says_so(
    stepped: SteppedClock,
) -> None:
    async with gateway(clock=stepped.clock, per_minute=3) as rig:
        await rig.follow()
        robot = rig.robot()

        def swing() -> None:
            robot.measure("event/fault", 1)
            robot.measure("event/fault", 0)

        async def dock(_value: Any, _progress: Any) -> float:
            asyncio.get_running_loop().call_later(0.05, swing)  # once the command has ended
            return 1.0

        robot.behaviours["action/dock"] = dock
        await rig.made(when="event.fault == 0", execute={"path": "/action/dock", "value": 1.0})
        robot.measure("event/fault", 0)
        told = await rig.happened("limited")
        assert "per_minute" in told["detail"]
        row = await rig.on_robot()
        assert (row["firings"], row["limited"]) == (3, True)
        ran = len(robot.ran)
        assert ran == 3
        for _ in range(20):
            swing()
        assert await rig.eventually(lambda: _is(rig, suppressed=21))
        assert len(robot.ran) == ran
        stepped.advance(60)  # then it may again
        swing()
        await rig.eventually(lambda: _is(rig, limited=True, firings=6))


async def test_each_of_two_events_at_once_is_looked_at() -> None:
    async with gateway() as rig:
        await rig.follow()
        rig.robot().measure("event/fault", 1)
        await rig.made(when="event.fault == 7", on="edge", alarm=True)
        for fault in (7, 0):
            rig.robot().measure("event/fault", fault)
        await rig.happened("fired")
        await rig.happened("cleared")


async def test_one_may_make_what_one_may_read_and_sees_no_more() -> None:
    async with gateway() as rig:
        limited, other = rig.client(LIMITED), rig.client(OTHER)
        secret = {"when": "sensor.secret > 5", "alarm": True}
        assert code(await rig.add(limited, **secret)) == "unknown_path"
        assert code(await rig.add(other, alarm=True)) == "forbidden"
        assert code(await rig.add(robot="/tenant/*", alarm=True)) == "forbidden"
        assert code(await rig.add(when="sensor.nothing > 5", alarm=True)) == "unknown_path"
        assert code(await rig.add(when="sensor.battery >", alarm=True)) == "invalid_value"
        assert code(await rig.add()) == "invalid_value"
        assert code(await rig.add(notify=["nobody"])) == "invalid_value"
        assert code(await rig.add(incident=True)) == "not_implemented"
        dock = {"path": "/system/configuration"}
        assert code(await rig.add(execute=dock)) == "invalid_value"
        await rig.made(**secret)
        rig.robot().measure("sensor/secret", 9.0)
        await rig.eventually(rig.alarms)
        assert (await limited.request("read", TRIGGERS))["body"] == []
        assert await rig.alarms(limited) == []
        assert await rig.alarms(other) == []
        id_ = await limited.subscribe(FIRINGS, history=10)
        await limited.request("ping")
        assert not [m for m in limited.inbox if m.get("id") == id_ and m["type"] == "update"]
        assert code(await rig.add(**secret)) == "mode_forbids"
        removal = {"remove": "low"}
        assert code(await limited.request("execute", TRIGGERS, body=removal)) == "unknown_path"
        assert (await rig.operator.request("execute", TRIGGERS, body=removal))[
            "status"
        ] == "completed"
        assert (await rig.alarms())[0]["state"] == "cleared"


async def test_a_test_says_what_it_would_do_and_does_nothing() -> None:
    async with gateway() as rig:
        rig.robot().measure("sensor/battery", 50.0)
        await rig.made(alarm=True, execute={"path": "/action/dock", "value": 300.0})
        reply = await rig.operator.request("execute", TRIGGERS, body={"test": "low"})
        (result,) = reply["body"]["robots"]
        assert result["condition"] == "false"
        assert result["would"] == ["raise an alarm", "execute /action/dock"]
        assert "100" in result["refused"]
        assert (rig.robot().ran, await rig.alarms()) == ([], [])


async def test_every_firing_is_in_the_audit_log() -> None:
    async with gateway() as rig:
        id_ = await rig.admin.subscribe("/system/audit", qos={"reliability": "reliable"})
        await rig.made(alarm=True)
        rig.robot().measure("sensor/battery", 10.0)

        def fired(message: dict[str, Any]) -> bool:
            body = message.get("body") or {}
            return message.get("id") == id_ and (body.get("what"), body.get("outcome")) == (
                "trigger",
                "fired",
            )

        record = (await rig.admin.until(fired))["body"]
        assert (record["trigger"], record["principal"]) == ("low", "operator")
        assert record["alarm"].startswith("al-")
        assert record["touches"] == ["/tenant/alpha/sensor/battery"]


async def test_metrics_follow_the_conventions() -> None:
    async with gateway() as rig:
        await rig.made(alarm=True)
        rig.robot().measure("sensor/battery", 10.0)
        await rig.eventually(rig.alarms)
        kernel = rig.served.server.gateway
        session = rig.served.server.client_api.session(
            rig.served.server.client_api.authenticate(ADMIN)
        )
        text = b"".join(_finished(kernel.exposition.write(session.rights))).decode()
        assert 'rcp_trigger_firings_total{result="fired"} 1.0' in text
        assert 'rcp_alarms{state="active"} 1.0' in text
        assert 'rcp_trigger_robots{state="active"} 1.0' in text


def _finished(steps: Any) -> list[bytes]:
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return [end.value]


async def test_the_targets_of_others_and_more_triggers_than_one_may_have_are_refused() -> None:
    targets = {"ops": {"kind": "ntfy", "url": "https://ntfy.invalid/ops", "tenants": ["beta"]}}
    async with gateway(targets=targets, most=1) as rig:
        refused = await rig.add(notify=["ops"])
        assert code(refused) == "invalid_value"
        assert "no target 'ops' for alpha" in refused["message"]
        await rig.made(alarm=True)
        assert code(await rig.add(name="second", alarm=True)) == "queue_full"
        await rig.made(rig.admin, name="second", alarm=True)
