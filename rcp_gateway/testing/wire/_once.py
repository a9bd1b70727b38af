"""Section 3 of the contract: repeats, dry runs and batches."""

from __future__ import annotations

from typing import Any

from rcp_gateway.testing._client import Message
from rcp_gateway.testing._suite import proves
from rcp_gateway.testing.wire._base import Wire, World

__all__ = ["Once"]

GO = {"distance": 3.0}
NO_BATCHES: tuple[Any, ...] = (None, {}, 3, "x")


class Once(Wire):
    """Tests of what runs once, not at all, or concurrently."""

    @proves("envelope.once")
    async def test_a_repeat_under_a_key_returns_the_first_outcome_and_runs_nothing(
        self, world: World
    ) -> None:
        client = await world.client()
        first, again = [
            await client.request("execute", "/action/go", body=GO, idempotency_key="k-1")
            for _ in range(2)
        ]
        assert (first["status"], first["body"]) == ("completed", 3.0)
        assert (again["command"], again["body"]) == (first["command"], 3.0)
        for id_ in ("w-1", "w-2"):
            written = await client.request(
                "write", "/param/limit", body=2.0, idempotency_key="k-2", id=id_
            )
            assert (written["status"], written["body"], written["id"]) == ("completed", 2.0, id_)
        assert len(world.robot().ran) == len(world.robot().writes) == 1

    @proves("envelope.once")
    async def test_a_key_belongs_to_its_principal(self, world: World) -> None:
        for token in (None, "admin-of-the-test-kit"):
            client = await world.client(token) if token else await world.client()
            body = 1.0 if token else 2.0
            reply = await client.request("write", "/param/limit", body=body, idempotency_key="k")
            assert reply["body"] == body

    @proves("envelope.once-running")
    async def test_a_repeat_while_the_first_is_under_way_waits_for_its_outcome(
        self, world: World
    ) -> None:
        client = await world.client()
        write: Message = {"type": "write", "path": "/param/slow", "body": 1.0}
        ids = [await client.send(write, idempotency_key="k") for _ in range(2)]
        await client.request("ping")
        world.robot().release.set()
        assert [(await client.final(id_))["status"] for id_ in ids] == ["completed"] * 2
        assert len(world.robot().writes) == 1

    @proves("envelope.key-clash")
    async def test_a_key_used_for_something_else_is_refused(self, world: World) -> None:
        client = await world.client()
        await client.request("write", "/param/limit", body=2.0, idempotency_key="k")
        for request in (
            {"type": "write", "path": "/param/limit", "body": 1.0},
            {"type": "write", "path": "/param/cut", "body": 2.0},
            {"type": "execute", "path": "/action/go", "body": GO},
        ):
            reply = await client.final(await client.send(request, idempotency_key="k"))
            assert reply["error"]["code"] == "duplicate_request", request
        assert world.robot().values["param/limit"] == 2.0

    @proves("envelope.dry-run")
    async def test_a_dry_run_changes_nothing_and_says_what_would_happen(self, world: World) -> None:
        client = await world.client()
        write = await client.request("write", "/param/limit", body=2.0, dry_run=True)
        assert (write["status"], write["dry_run"]) == ("completed", True)
        assert write["body"]["write"] == 2.0
        execute = await client.request("execute", "/action/go", body=GO, dry_run=True)
        assert execute["body"]["execute"]["distance"] == 3.0
        assert (world.robot().writes, world.robot().ran) == ([], [])
        assert (await client.request("read", "/param/limit"))["body"] == 1.5

    @proves("envelope.dry-run-refused")
    async def test_a_dry_run_is_refused_as_the_real_one_would_be(self, world: World) -> None:
        client, viewer = await world.client(), await world.client(None)
        write: Message = {"type": "write", "path": "/param/limit", "body": 9.0}
        refusals: list[tuple[Any, Message, str]] = [
            (client, write, "out_of_range"),
            (viewer, write | {"body": 1.0}, "forbidden"),
            (client, {"type": "execute", "path": "/action/ghost/go"}, "invalid_value"),
            (
                client,
                {"type": "execute", "path": "/action/ghost/go", "body": GO},
                "adapter_unavailable",
            ),
            (client, write | {"path": "/sensor/level"}, "unsupported_operation"),
        ]
        for principal, request, code in refusals:
            dry = await principal.final(await principal.send(request, dry_run=True))
            real = await principal.final(await principal.send(request))
            assert dry["error"]["code"] == real["error"]["code"] == code

    @proves("envelope.atomic")
    async def test_several_paths_are_written_as_one(self, world: World) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            body = {"/param/limit": 2.0, "/param/cut": 3.0}
            reply = await client.request("write", body=body, id="both", idempotency_key=encoding)
            assert (reply["status"], reply["id"]) == ("completed", "both"), reply
            told = [(item["path"].rpartition("/")[2], item["body"]) for item in reply["body"]]
            assert told == [("limit", 2.0), ("cut", 1.0)]
            again = await client.request("write", body=body, idempotency_key=encoding)
            assert again["body"] == reply["body"]
        assert len(world.robot().writes) == 2 * len(self.encodings)

    @proves("envelope.atomic-refused")
    async def test_one_refused_path_keeps_all_from_being_written(self, world: World) -> None:
        client = await world.client()
        wrong = {"/param/limit": 9.0, "/param/cut": "x", "/param/none": 1.0, "/param/refused": 1.0}
        reply = await client.request("write", body=wrong)
        assert (reply["status"], reply["error"]["code"]) == ("rejected", "out_of_range")
        faults = reply["error"]["details"]["faults"]
        assert [fault["code"] for fault in faults] == [
            "out_of_range",
            "invalid_value",
            "unknown_path",
        ]
        reply = await client.request("write", body={"/param/limit": 2.0, "/param/refused": 1.0})
        assert (reply["status"], reply["error"]["code"]) == ("failed", "device_rejected")
        assert reply["error"]["path"].endswith("/param/refused")
        assert world.robot().writes == []

    @proves("envelope.atomic-group")
    async def test_paths_without_a_common_group_are_not_written_one_by_one(
        self, world: World
    ) -> None:
        client = await world.client()
        reply = await client.request("write", body={"/param/limit": 2.0, "/param/label": "two"})
        assert (reply["status"], reply["error"]["code"]) == ("rejected", "not_implemented")
        assert world.robot().writes == []

    @proves("envelope.batch")
    async def test_a_batch_is_answered_in_its_own_order(self, world: World) -> None:
        world.publish("sensor/level", 1.0)
        parts: list[Any] = [
            {"type": "read", "path": "/sensor/silent", "id": "slow", "deadline": 0.1},
            {"type": "read", "path": "/sensor/level", "id": "quick"},
            {"type": "write", "path": "/param/limit", "body": 9.0},
            {"type": "execute", "path": "/action/go", "body": GO, "x-n": 1},
            {"type": "nonsense"},
            17,
        ]
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            reply = await client.request("batch", body=parts)
            assert reply["status"] == "completed"
            slow, quick, write, go, nonsense, number = reply["body"]
            assert (slow["id"], slow["error"]["code"]) == ("slow", "deadline_exceeded")
            assert (quick["id"], quick["body"]) == ("quick", 1.0)
            assert write["error"]["code"] == "out_of_range"
            assert (go["status"], go["body"], go["x-n"]) == ("completed", 3.0, 1)
            assert nonsense["error"]["code"] == number["error"]["code"] == "bad_request"

    @proves("envelope.batch-limits")
    async def test_a_batch_that_is_none_is_refused(self, world: World) -> None:
        client = await world.client()
        for body in NO_BATCHES:
            reply = await client.request("batch", body=body)
            assert reply["error"]["code"] == "invalid_value", body
        many = await client.request("batch", body=[{"type": "ping"}] * 65)
        assert many["error"]["code"] == "bad_request"
        nested = await client.request("batch", body=[{"type": "batch", "body": []}])
        assert nested["body"][0]["error"]["code"] == "bad_request"
        assert (await client.request("batch", body=[]))["body"] == []
