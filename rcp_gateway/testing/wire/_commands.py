"""Section 8 of the contract: the life of a command, its policies, and its end."""

from __future__ import annotations

import time

from rcp_gateway.testing._client import Client, Message
from rcp_gateway.testing._serve import VIEWER
from rcp_gateway.testing._suite import eventually, proves
from rcp_gateway.testing.wire._base import Wire, World

__all__ = ["Commands"]

GO = "/tenant/alpha/action/go"
CALL: Message = {"type": "execute", "path": "/service/nothing"}
NOTHING: tuple[Message, ...] = (CALL, CALL | {"body": None}, CALL | {"body": {}})
WAIT = {"distance": 4.0, "mode": "wait"}


async def _begun(client: Client, path: str = GO, distance: float = 4.0) -> Message:
    """Start a command that waits; return its first feedback."""
    body = {"distance": distance, "mode": "wait"}
    id_ = await client.send(type="execute", path=path, body=body)
    return await client.until(lambda m: m.get("id") == id_ and m["status"] == "in_progress")


class Commands(Wire):
    """Tests of executes."""

    @proves("command.life")
    async def test_a_command_is_accepted_in_progress_and_completed(self, world: World) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            id_ = await client.send(type="execute", path="/action/go", body={"distance": 4})
            accepted, feedback, done = await client.replies(id_)
            assert accepted["status"] == "accepted"
            assert (feedback["status"], feedback["body"]) == ("in_progress", 2.0)
            assert feedback["progress"] == 0.5
            assert (done["status"], done["body"]) == ("completed", 4.0)
            assert accepted["command"] == feedback["command"] == done["command"]
            assert {reply["path"] for reply in (accepted, feedback, done)} == {GO}

    @proves("command.completed", "envelope.message")
    async def test_a_completed_command_carries_its_result(self, world: World) -> None:
        client = await world.client()
        done = await client.request("execute", "/action/go", body={"distance": 4})
        assert (done["status"], done["body"]) == ("completed", 4.0)
        assert done["message"] == f"Command {GO} executed successfully."
        assert done["command"]
        again = await client.request("execute", "/action/go", body={"distance": 4})
        assert again["command"] != done["command"]

    @proves("command.failed", "command.rejected")
    async def test_what_the_robot_makes_of_it_decides_the_final_status(self, world: World) -> None:
        client = await world.client()
        for mode, status, code, reason in (
            ("refuse", "rejected", "device_rejected", "the way is blocked"),
            ("stumble", "failed", "device_rejected", "lost the way"),
            ("timeout", "failed", "device_timeout", "did not answer"),
        ):
            reply = await client.request("execute", GO, body={"distance": 4, "mode": mode})
            assert (reply["status"], reply["error"]["code"]) == (status, code)
            assert reason in reply["message"]
            assert reply["command"]

    @proves("command.input")
    async def test_an_input_that_does_not_fit_begins_nothing(self, world: World) -> None:
        client = await world.client()
        for body in (None, {}, {"distance": "far"}, {"distance": 101}, {"distance": 1, "x": 1}):
            reply = await client.request("execute", GO, body=body)
            assert reply["status"] == "rejected"
            assert reply["error"]["code"] in ("invalid_value", "out_of_range")
            assert "command" not in reply
        assert world.robot().ran == []

    @proves("command.no-input")
    async def test_a_call_without_input_takes_nothing(self, world: World) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            for fields in NOTHING:
                reply = await client.final(await client.send(fields))
                assert reply["status"] == "completed", reply
            bad = await client.request("execute", "/service/nothing", body={"a": 1})
            assert bad["error"]["code"] == "invalid_value"

    @proves("command.cancel-path")
    async def test_a_cancel_by_path_reaches_the_robot(self, world: World) -> None:
        client, other = await world.client(), await world.client()
        begun = await _begun(client)
        reply = await other.request("cancel", "/action/go")
        assert (reply["status"], reply["body"]) == ("completed", {"cancelled": [begun["command"]]})
        final = await client.final(begun["id"])
        assert (final["status"], final["error"]["code"]) == ("cancelled", "cancelled")
        assert world.robot().stopped == ["action/go"]

    @proves("command.cancel-id")
    async def test_a_cancel_by_id_ends_that_command(self, world: World) -> None:
        client = await world.client()
        for named in ("envelope", "body"):
            first, second = [await _begun(client, "/action/beside") for _ in range(2)]
            id_ = second["command"]
            cancel: Message = {"command": id_}
            if named == "body":
                cancel = {"body": cancel}
            reply = await client.final(await client.send(cancel, type="cancel"))
            assert reply["status"] == "completed"
            assert (await client.final(second["id"]))["status"] == "cancelled"
            world.robot().release.set()
            assert (await client.final(first["id"]))["status"] == "completed"
            world.robot().release.clear()

    @proves("command.cancel-nothing")
    async def test_a_cancel_where_nothing_runs_says_so(self, world: World) -> None:
        client = await world.client()
        nothing = await client.request("cancel", "/action/go")
        assert (nothing["status"], nothing["body"]) == ("completed", {"cancelled": []})
        assert "Nothing is running" in nothing["message"]
        unknown = await client.request("cancel", command="cmd-0")
        assert unknown["error"]["code"] == "unknown_path"
        sensor = await client.request("cancel", "/sensor/level")
        assert sensor["error"]["code"] == "unsupported_operation"

    @proves("command.cancel-denied")
    async def test_who_may_not_execute_may_not_cancel(self, world: World) -> None:
        client, viewer = await world.client(), await world.client(VIEWER)
        begun = await _begun(client)
        by_path = await viewer.request("cancel", "/action/go")
        assert by_path["error"]["code"] == "forbidden"
        by_id = await viewer.request("cancel", command=begun["command"])
        assert by_id["error"]["code"] in ("forbidden", "unknown_path")
        world.robot().release.set()
        assert (await client.final(begun["id"]))["status"] == "completed"

    @proves("command.reject")
    async def test_a_second_one_is_rejected_while_the_first_runs(self, world: World) -> None:
        client = await world.client()
        begun = await _begun(client)
        second = await client.request("execute", "/action/go", body=WAIT)
        assert (second["status"], second["error"]["code"]) == ("rejected", "already_running")
        message = f"Warning: action '{GO}' is currently in progress; rejecting duplicate request."
        assert second["message"] == message
        assert second["error"]["details"]["command"] == begun["command"]
        assert len(world.robot().ran) == 1
        world.robot().release.set()
        assert (await client.final(begun["id"]))["status"] == "completed"
        third = await client.request("execute", "/action/go", body={"distance": 1})
        assert third["status"] == "completed"

    @proves("command.queue")
    async def test_a_queued_one_waits_its_turn_or_is_taken_out(self, world: World) -> None:
        client = await world.client()
        first = await _begun(client, "/action/line", 1.0)
        waiting = [
            await client.send(type="execute", path="/action/line", body={"distance": d})
            for d in (2.0, 3.0, 4.0)
        ]
        pending = [
            await client.until(lambda m, i=id_: m.get("id") == i and m["status"] == "pending")
            for id_ in waiting
        ]
        await client.request("cancel", command=pending[1]["command"])
        assert (await client.final(waiting[1]))["status"] == "cancelled"
        world.robot().release.set()
        for id_ in (first["id"], waiting[0], waiting[2]):
            assert (await client.final(id_))["status"] == "completed"
        assert [value.distance for _, value in world.robot().ran] == [1.0, 2.0, 4.0]

    @proves("command.queue", "error.queue-full")
    async def test_the_line_has_an_end(self, world: World) -> None:
        client = await world.client()
        await _begun(client, "/action/line")
        for _ in range(16):
            await client.send(type="execute", path="/action/line", body=WAIT)
        full = await client.request("execute", "/action/line", body=WAIT)
        assert (full["error"]["code"], full["error"]["retryable"]) == ("queue_full", True)

    @proves("command.preempt")
    async def test_a_preempting_one_ends_the_running_one_and_follows_it(self, world: World) -> None:
        client = await world.client()
        first = await _begun(client, "/action/dash", 1.0)
        done = await client.request("execute", "/action/dash", body={"distance": 2.0})
        assert done["status"] == "completed"
        final = await client.final(first["id"])
        assert final["status"] == "cancelled"
        assert "preempted" in final["message"]
        assert [value.distance for _, value in world.robot().ran] == [1.0, 2.0]
        assert world.robot().stopped == ["action/dash"]

    @proves("command.parallel")
    async def test_parallel_ones_run_side_by_side(self, world: World) -> None:
        client = await world.client()
        begun = [await _begun(client, "/action/beside", float(i)) for i in range(5)]
        assert len({feedback["command"] for feedback in begun}) == 5
        world.robot().release.set()
        for feedback in begun:
            assert (await client.final(feedback["id"]))["status"] == "completed"

    @proves("command.timeout")
    async def test_a_command_past_its_time_ends_and_the_robot_is_told(self, world: World) -> None:
        client = await world.client()
        for path, fields in (("/action/short", {}), ("/action/go", {"deadline": 0.1})):
            started = time.monotonic()
            reply = await client.request("execute", path, body=WAIT, **fields)
            assert (reply["status"], reply["error"]["code"]) == ("failed", "deadline_exceeded")
            assert "within 0.1 s" in reply["message"] or "in time" in reply["message"]
            assert time.monotonic() - started > 0.05
        assert world.robot().stopped == ["action/short", "action/go"]

    @proves("command.outlives")
    async def test_a_command_goes_on_when_its_connection_ends_unless_it_is_tied(
        self, world: World
    ) -> None:
        client, other, robot = await world.client(), await world.client(), world.robot()
        begun = await _begun(client)
        await _begun(client, "/action/tied")
        await client.close()

        async def tied_stopped() -> bool:
            return robot.stopped == ["action/tied"]

        await eventually(tied_stopped, "the tied command ends with its client")
        robot.release.set()

        async def listed() -> bool:
            body = (await other.request("read", "/system/commands"))["body"]
            return {c["command"]: c["status"] for c in body}.get(begun["command"]) == "completed"

        await eventually(listed, "the other one is completed")

    @proves("command.listed")
    async def test_commands_are_listed_with_their_history(self, world: World) -> None:
        client = await world.client()
        good = await client.request("execute", "/action/go", body={"distance": 4}, id="g")
        bad = await client.request("execute", GO, body={"distance": 4, "mode": "stumble"})
        listed = (await client.request("read", "/system/commands"))["body"]
        assert [c["command"] for c in listed] == [bad["command"], good["command"]]
        command = listed[1]
        assert (command["path"], command["principal"], command["id"]) == (GO, "operator", "g")
        assert [step["status"] for step in command["history"]] == [
            "accepted",
            "in_progress",
            "completed",
        ]
        assert (command["input"]["distance"], command["body"]) == (4.0, 4.0)
        assert listed[0]["error"]["code"] == "device_rejected"
