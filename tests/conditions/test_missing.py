"""Without the extra that evaluates conditions, whoever gives one is told how to get it."""

from __future__ import annotations

import sys
from importlib.util import find_spec

import pytest

from kernel.world import world_of
from plugins.plans.planned import code, echo, run
from plugins.triggers.gateway import gateway
from rcpd.diagnosis import Diagnosis

EXTRA = "pip install 'rcp-gateway[conditions]'"
ROLE = """\
[tenants.alpha]
[roles.driver]
allow = [{ paths = ["/**"], operations = ["read"], when = "sensor.battery.percentage > 21" }]
"""
LIMIT = """\
[tenants.alpha]
[[envelopes]]
name = "slow"
paths = ["/actuator/cmd_vel"]
when = "sensor.battery.percentage > 22"
"""
TRIGGER = """\
[tenants.alpha]
[features.triggers.rules.low]
robot = "/tenant/alpha/rover"
when = "sensor.battery.percentage > 23"
alarm = true
"""


@pytest.fixture
def missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cel", None)


@pytest.mark.usefixtures("missing")
async def test_a_plan_with_a_condition_names_the_extra() -> None:
    async with world_of() as world:
        reply = await run(world.client(), echo(when="sensor.level > 24.0", id="dear"))
        assert code(reply) == "not_implemented"
        (fault,) = reply["error"]["details"]["faults"]
        assert (fault["step"], fault["details"]["pointer"]) == ("dear", "/when")
        assert EXTRA in fault["remedy"]
        assert code(await run(world.client(), echo())) == "completed"


@pytest.mark.anyio
async def test_a_trigger_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    async with gateway() as rig:
        monkeypatch.setitem(sys.modules, "cel", None)
        reply = await rig.add(when="sensor.battery > 25", alarm=True)
        assert code(reply) == "not_implemented"
        assert EXTRA in reply["error"]["remedy"]


@pytest.mark.usefixtures("missing")
@pytest.mark.parametrize("text", [ROLE, LIMIT])
def test_a_check_of_the_file_names_the_extra(text: str) -> None:
    (found,) = Diagnosis(text, "rcp.toml").findings
    assert EXTRA in found.message


def test_a_check_of_triggers_names_their_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "rcp_gateway.plugins.find_spec", lambda name: None if name == "cel" else find_spec(name)
    )
    (found,) = Diagnosis(TRIGGER, "rcp.toml").findings
    assert "pip install 'rcp-gateway[triggers]'" in found.message
