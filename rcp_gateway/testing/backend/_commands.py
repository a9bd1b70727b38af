"""The commands of a backend: they complete, fail with a reason, and end when they are cancelled."""

from __future__ import annotations

from rcp_gateway.testing._schemas import beyond
from rcp_gateway.testing.backend._base import BackendTests, Robot
from rcp_kernel.model import Kind, Operation
from rcp_kernel.values import value_type

__all__ = ["CommandTests"]

_ROBOTS_REASONS = {
    *("device_rejected", "device_timeout", "invalid_value", "out_of_range"),
    *("precondition_failed", "mode_forbids", "not_implemented"),
}


class CommandTests(BackendTests):
    """Tests of its actions and services."""

    async def test_a_good_goal_completes_in_the_state_it_reports(self, robot: Robot) -> None:
        for name, goal in self.goals().items():
            reply = await self.complete(name, goal.good)
            assert reply["status"] == "completed", reply
            if robot.resources[name].output is not None:
                assert await self.confirms(name, reply["body"]), f"{name}: {reply['body']!r}"
        assert robot.faults == 0, robot.last_error

    async def test_services_answer_their_examples(self, robot: Robot) -> None:
        for resource in robot.having(Operation.EXECUTE, Kind.SERVICE):
            if resource.name in self.goals():
                continue
            inputs = [None] if resource.input is None else resource.examples
            for value in inputs:
                reply = await robot.ask("execute", resource.name, body=value)
                assert reply["status"] == "completed", reply

    async def test_a_goal_that_the_robot_cannot_do_fails_with_a_reason(self, robot: Robot) -> None:
        for name, goal in self.goals().items():
            if not goal.fails:
                continue
            reply = await self.complete(name, goal.bad)
            assert reply["status"] in ("failed", "rejected"), reply
            assert reply["error"]["code"] in _ROBOTS_REASONS, reply
            assert len(reply["message"]) > len(name) // 2, "say why"

    async def test_an_input_out_of_range_is_refused_before_it_begins(self, robot: Robot) -> None:
        for resource in robot.having(Operation.EXECUTE):
            for value in beyond(value_type(resource.input).schema):
                reply = await robot.ask("execute", resource.name, body=value)
                assert reply["error"]["code"] == "out_of_range", (resource.name, value, reply)
                assert "command" not in reply

    async def test_a_goal_can_be_cancelled_and_the_robot_rests(self, robot: Robot) -> None:
        for name in self.actions():
            id_ = await self.begin(name)
            reply = await robot.ask("cancel", name)
            assert reply["body"]["cancelled"], f"{name} had ended already: give Goal.long"
            final = await robot.client.final(id_, self.cancel_within)
            assert final["status"] == "cancelled", final
            await self.comes_to_rest(f"{name} was cancelled")

    async def test_after_a_cancel_the_next_goal_is_taken(self, robot: Robot) -> None:
        for name in self.actions():
            id_ = await self.begin(name)
            await robot.ask("cancel", name)
            await robot.client.final(id_, self.cancel_within)
            reply = await self.complete(name, self.goals()[name].good)
            assert reply["status"] == "completed", reply

    async def test_a_goal_past_its_deadline_is_stopped(self, robot: Robot) -> None:
        for name in self.actions():
            await self.prepare(name)
            lasting = self.goals()[name].lasting
            reply = await robot.ask("execute", name, body=lasting, deadline=0.05)
            assert reply["error"]["code"] == "deadline_exceeded", reply
            await self.comes_to_rest(f"the deadline of {name}")
