"""What is wrong in `[features.triggers]` is said before the gateway starts, with a remedy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

import rcp_recorder
from configuration import backend, configuration, key, table
from plugins.triggers.gateway import ADMIN, KIND, gateway, webhook
from rcp_gateway.features import active
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError

RULE = {"robot": "/tenant/alpha", "when": "sensor.battery < 20"}
DOCK = {"path": "/action/dock", "value": 1.0}


def check(**options: Any) -> None:
    text = configuration(
        backend("rover"), key("admin", ADMIN), table("features.triggers", **options)
    )
    active(parse(text, "test"), {"triggers": KIND}, "test")


@pytest.mark.parametrize(
    ("rule", "said"),
    [
        ({"alarm": True, "incident": True}, r"\[features.recorder.black_box\]"),
        ({"execute": DOCK}, "run_as"),
        ({"execute": DOCK, "run_as": {"role": "operater"}}, "did you mean 'operator'"),
        ({"execute": {"path": "/system/configuration"}}, "cannot use /system/configuration"),
        ({"alarm": True, "robot": "alpha"}, "names no robot"),
        ({"alarm": True, "robot": "/tenant/gamma"}, "no tenant 'gamma'"),
        ({"alarm": True, "when": "battery < 20"}, "refer to a value by its branch"),
        ({"alarm": True, "on": "edge", "repeat": 60}, "`repeat` goes with"),
        ({"notify": ["nobody"]}, "no target 'nobody'; known: ops"),
        ({}, "it does nothing"),
    ],
)
def test_a_faulty_rule_is_refused_with_its_name(rule: dict[str, Any], said: str) -> None:
    targets = {"ops": webhook("https://ops.example/hook")}
    with pytest.raises(ConfigError, match=r"rules.low.*" + said):
        check(targets=targets, rules={"low": RULE | rule})


@pytest.mark.parametrize(
    ("target", "said"),
    [
        (webhook("https://ops.example/hook") | {"secret": "short"}, "openssl rand -base64 32"),
        (webhook("file:///etc/passwd"), "url"),
        (webhook("https://user:pass@ops.example/hook"), "url"),
        (webhook("https://ops.example/hook", tenants=["gamma"]), "no tenant 'gamma'"),
        ({"kind": "smtp", "host": "mail", "sender": "a b", "to": ["x@y.z"]}, "sender"),
        ({"kind": "pager"}, "kind"),
    ],
)
def test_a_faulty_target_is_refused(target: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        check(targets={"ops": target})


@pytest.mark.anyio
async def test_a_configured_trigger_has_the_role_that_it_is_given() -> None:
    rules = {
        "dock": RULE | {"execute": DOCK, "run_as": {"role": "operator", "tenants": ["alpha"]}},
        "look": RULE | {"execute": DOCK, "run_as": {"role": "viewer"}},
    }
    async with gateway(rules=rules) as rig:
        await rig.follow()
        rig.robot().measure("sensor/battery", 10.0)
        ended = {one["trigger"]: one for one in [await rig.happened("command") for _ in rules]}
        assert (ended["dock"]["outcome"], ended["look"]["outcome"]) == ("completed", "forbidden")
        assert rig.robot().ran == [("action/dock", 1.0)]
        body = {"remove": "dock"}
        reply = await rig.admin.request("execute", "/system/triggers", body=body)
        assert reply["error"]["code"] == "forbidden"
        assert "[features.triggers.rules.dock]" in reply["error"]["remedy"]


@pytest.mark.anyio
async def test_a_reload_keeps_what_is_as_before_and_ends_the_rest() -> None:
    rules = {"low": RULE | {"alarm": True}, "gone": RULE | {"alarm": True}}
    async with gateway(rules=rules) as rig:
        rig.robot().measure("sensor/battery", 10.0)

        async def both() -> bool:
            return len(await rig.alarms()) == 2

        await rig.eventually(both)
        kernel = rig.served.server.gateway
        features = {"triggers": {"rules": {"low": rules["low"], "new": RULE | {"alarm": True}}}}
        config = msgspec.structs.replace(kernel.settings.config, features=features)
        only = [one for one in active(config, {"triggers": KIND}, "test") if one.kind is KIND]
        kernel.reconfigure(config, only)

        async def three() -> bool:
            return len(await rig.alarms()) == 3

        await rig.eventually(three)
        states = {one["trigger"]: one["state"] for one in await rig.alarms()}
        assert states == {"low": "active", "gone": "cleared", "new": "active"}
        assert (await rig.on_robot("low"))["firings"] == 1


@pytest.mark.anyio
async def test_it_has_the_black_box_write_an_incident(tmp_path: Path) -> None:
    (recorder,) = rcp_recorder.rcp_features()
    box = table("features.recorder", folder=tmp_path, free_mb=0, black_box={"after": 0.1})
    rule = RULE | {"incident": True, "message": "Battery low"}
    async with gateway(box, features=(recorder,), rules={"low": rule}) as rig:
        await rig.follow()
        rig.robot().measure("sensor/battery", 50.0)
        rig.robot().measure("sensor/battery", 10.0)
        await rig.happened("fired")

        async def kept() -> Any:
            reply = await rig.admin.request("read", "/system/recorder")
            return [one for one in reply["body"] if one["state"] == "kept"]

        (incident,) = await rig.eventually(kept)
        assert incident["reason"] == "trigger low: Battery low"
        assert incident["robot"] == "/tenant/alpha"
        assert incident["messages"] >= 2


@pytest.mark.anyio
async def test_one_rule_watches_each_robot_of_a_tenant_by_itself() -> None:
    robots = backend("one", robot="r1") + backend("two", robot="r2", use="second")
    rule = {"robot": "/tenant/alpha/*", "when": RULE["when"], "alarm": True}
    dock = {"path": "/action/{robot}/dock", "value": 1.0}
    more = {"execute": dock, "run_as": {"role": "operator"}}
    async with gateway(
        robots=robots + backend("other", "beta", use="robot"), rules={"low": rule | more}
    ) as rig:
        await rig.follow()
        rig.robot("second").measure("sensor/battery", 10.0)
        fired = await rig.happened("fired")
        assert fired["robot"] == "/tenant/alpha/r2"
        assert (await rig.happened("command"))["outcome"] == "completed"
        assert rig.robot("second").ran == [("action/dock", 1.0)]
        assert [one["robot"] for one in await rig.alarms()] == ["/tenant/alpha/r2"]
        states = {one["robot"]: one["condition"] for one in (await rig.row())["robots"]}
        assert states == {"/tenant/alpha/r1": "unknown", "/tenant/alpha/r2": "true"}
