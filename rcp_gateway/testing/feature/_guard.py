"""Requirements of a guard: it refuses commands, but never one that brings a robot to rest."""

from __future__ import annotations

from typing import Any

import pytest

from rcp_gateway.testing._suite import eventually, proves
from rcp_gateway.testing.feature._rig import FeatureGateway, FeatureRig, error_code
from rcp_kernel.features import Slot

__all__ = ["GuardTests"]

DRIVE, LIMIT, GO = "/actuator/drive", "/param/limit", "/action/go"
COMMANDS = (("write", LIMIT), ("write", DRIVE), ("execute", GO))


class GuardTests(FeatureRig):
    """Tests of every guard."""

    @proves("guard.refuses")
    @pytest.mark.parametrize(("type_", "path"), COMMANDS)
    async def test_what_it_refuses_does_not_reach_the_robot(
        self, guarded: FeatureGateway, type_: str, path: str
    ) -> None:
        await self.engage(guarded)
        for dry in (False, True):
            if dry and self.refusal == "approval_required":
                continue  # a dry run calls no guard
            reply = await guarded.operator.request(type_, path, body=0.5, dry_run=dry)
            assert error_code(reply) == self.refusal
            assert reply["error"].get("remedy"), "a refusal says what to do next"
        assert guarded.robot.reached == []

    @proves("guard.passes")
    @pytest.mark.parametrize(("type_", "path"), COMMANDS)
    async def test_what_it_lets_pass_again_reaches_the_robot(
        self, guarded: FeatureGateway, type_: str, path: str
    ) -> None:
        await self.engage(guarded)
        await self.release(guarded)
        guarded.robot.release.set()
        reply = await guarded.operator.request(type_, path, body=0.5)
        assert (reply["status"], error_code(reply)) == ("completed", None)
        assert len(guarded.robot.reached) == 1

    @proves("guard.rest")
    async def test_it_keeps_nobody_from_bringing_a_robot_to_rest(
        self, guarded: FeatureGateway
    ) -> None:
        stops: tuple[tuple[str, str, Any], ...] = (
            ("write", DRIVE, 0.0),
            ("execute", "/service/hold", {}),
            ("execute", "/system/estop", {}),
        )
        guards = guarded.served.server.gateway.features.guards
        controls = any(guard.slot is Slot.LEASE for guard in guards)
        for type_, path, body in stops[controls:]:
            moving = await guarded.operator.request("write", DRIVE, body=0.5)
            assert moving["status"] == "completed", moving
            await self.engage(guarded)
            reply = await guarded.operator.request(type_, path, body=body)
            assert reply["status"] == "completed", reply
            assert guarded.robot.speed == 0
            await self.release(guarded)

    @proves("guard.plans")
    async def test_the_step_of_a_plan_passes_it_like_any_command(
        self, guarded: FeatureGateway
    ) -> None:
        await self.engage(guarded)
        plan = {"steps": [{"do": "write", "path": LIMIT, "value": 0.5}]}
        reply = await guarded.operator.request("execute", "/system/plans", body=plan)
        assert reply["status"] in ("failed", "rejected"), reply
        assert guarded.robot.reached == []

    @proves("guard.confirms")
    async def test_it_refuses_what_waited_when_its_turn_comes(
        self, guarded: FeatureGateway
    ) -> None:
        operator, robot = guarded.operator, guarded.robot
        first = await operator.send(type="execute", path=GO, body=0.25)

        async def begun() -> bool:
            return bool(robot.reached)

        await eventually(begun, "the first command runs")
        second = await operator.send(type="execute", path=GO, body=0.75)
        await operator.until(lambda m: m.get("id") == second and m.get("status") == "pending")
        await self.engage(guarded)
        robot.release.set()
        assert (await operator.final(first))["status"] == "completed"
        assert error_code(await operator.final(second)) == self.refusal
        assert robot.reached == [("action/go", 0.25)]

    @proves("guard.reloads")
    async def test_it_still_refuses_after_a_reload(self, guarded: FeatureGateway) -> None:
        await self.engage(guarded)
        kernel = guarded.served.server.gateway
        config = kernel.settings.config
        kernel.reconfigure(config, self.features(config))
        reply = await guarded.operator.request("write", LIMIT, body=0.5)
        assert error_code(reply) == self.refusal
