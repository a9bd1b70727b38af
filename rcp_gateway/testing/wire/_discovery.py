"""Discovery and the health report."""

from __future__ import annotations

from typing import Any

from rcp_gateway.testing._client import Client, Message
from rcp_gateway.testing._serve import ADMIN, VIEWER
from rcp_gateway.testing._suite import eventually, proves
from rcp_gateway.testing.wire._base import LOCAL, Wire, World
from rcp_kernel.model import Resource
from rcp_kernel.types import quantity

__all__ = ["Discovery"]


async def _found(client: Client, pattern: str | None = None, **query: Any) -> list[Message]:
    reply = await client.request("discover", pattern, body=query)
    assert reply["status"] == "completed", reply
    return reply["body"]["resources"]


def _names(found: list[Message]) -> set[str]:
    return {item["path"].removeprefix("/tenant/alpha/") for item in found}


class Discovery(Wire):
    """Tests of discovery and status."""

    @proves("discover.facts")
    async def test_it_tells_all_about_a_resource(self, world: World) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)

            async def is_fresh(client: Client = client) -> bool:
                world.publish("sensor/level", 1.0)
                (level,) = await _found(client, "/sensor/level")
                return level["state"] == "fresh"

            # On a busy machine an answer may take longer than the value is fresh.
            await eventually(is_fresh, "a value that has just come is fresh")
            (level,) = await _found(client, "/sensor/level")
            assert level["path"] == "/tenant/alpha/sensor/level"
            assert (level["kind"], level["backend"]) == ("sensor", "main")
            assert level["operations"] == ["read", "subscribe"]
            assert level["description"] == "The water level in the tank."
            assert (level["unit"], level["examples"]) == ("m", [1.5])
            assert level["schemas"]["value"]["type"] == "number"
            (go,) = await _found(client, "/action/go")
            assert go["schemas"].keys() == {"input", "output", "feedback"}
            (ghost,) = await _found(client, "/sensor/ghost/level")
            assert ghost["state"] == "down"

    @proves("value.schema-published")
    async def test_every_schema_is_one_with_a_stable_id_that_its_examples_fit(
        self, world: World
    ) -> None:
        import jsonschema

        client = await world.client()
        first, again = await _found(client), await _found(client)
        assert first == again
        for item in first:
            for part, schema in item["schemas"].items():
                jsonschema.Draft202012Validator.check_schema(schema)
                assert schema["$id"].endswith(item["schema_ids"][part])
            main = item["schemas"].get("input", item["schemas"].get("value"))
            for example in item["examples"]:
                jsonschema.validate(example, main, jsonschema.Draft202012Validator)

    @proves("discover.default")
    async def test_without_a_pattern_it_tells_the_own_tenant(self, world: World) -> None:
        found = await _found(await world.client())
        assert all(item["path"].startswith("/tenant/alpha/") for item in found)
        assert {"sensor/level", "action/go", "sensor/drone1/level"} <= _names(found)

    @proves("discover.kind")
    async def test_it_is_narrowed_by_kind(self, world: World) -> None:
        client = await world.client()
        for kind in ("sensor", "actuator", "param", "action", "service", "event"):
            found = await _found(client, kind=kind)
            assert found
            assert {item["kind"] for item in found} == {kind}

    @proves("discover.op", "discover.rights")
    async def test_it_is_narrowed_by_what_the_asker_may_do(self, world: World) -> None:
        operator, viewer = await world.client(), await world.client(VIEWER)
        writable = _names(await _found(operator, op="write"))
        assert "param/limit" in writable
        assert "param/fixed" not in writable
        assert await _found(viewer, op="write") == []
        (limit,) = await _found(viewer, "/param/limit")
        assert limit["operations"] == ["read", "subscribe"]

    @proves("discover.rights")
    async def test_it_lists_nothing_that_is_hidden(self, world: World) -> None:
        local, admin = await world.client(LOCAL), await world.client(ADMIN)
        assert "sensor/secret" not in _names(await _found(local))
        assert "sensor/secret" in _names(await _found(admin))
        assert await _found(local, "/tenant/beta/**") == []

    @proves("discover.q")
    async def test_it_is_narrowed_by_words(self, world: World) -> None:
        client = await world.client()
        found = _names(await _found(client, q="TANK water"))
        assert found == {"sensor/level", "sensor/drone1/level", "sensor/ghost/level"}
        assert await _found(client, q="submarine") == []

    @proves("discover.profile")
    async def test_it_tells_profiles_and_is_narrowed_by_one(self, world: World) -> None:
        client = await world.client()
        (level,) = await _found(client, "/sensor/level")
        assert level["profiles"] == ["acme.tank/1.2"]
        for profile in ("acme.tank", "acme.tank/1", "acme.tank/1.2"):
            found = _names(await _found(client, profile=profile))
            assert found == {"sensor/level", "sensor/drone1/level", "sensor/ghost/level"}
        for profile in ("acme", "acme.tan", "acme.tank/2", "acme.tank/1.20", ""):
            assert await _found(client, profile=profile) == []

    @proves("discover.pages")
    async def test_its_pages_are_the_whole_without_repeats(self, world: World) -> None:
        client = await world.client()
        whole = [item["path"] for item in await _found(client)]
        pages: list[str] = []
        cursor: dict[str, str] = {}
        for _ in range(len(whole)):
            body = (await client.request("discover", body={"limit": 7, **cursor}))["body"]
            assert len(body["resources"]) <= 7
            pages += [item["path"] for item in body["resources"]]
            if "cursor" not in body:
                break
            cursor = {"cursor": body["cursor"]}
        assert pages == whole

    @proves("discover.schemas")
    async def test_schemas_may_be_left_out(self, world: World) -> None:
        (level,) = await _found(await world.client(), "/sensor/level", schemas=False)
        assert "schemas" not in level
        assert level["schema_ids"]["value"]

    @proves("discover.refused")
    async def test_what_cannot_be_asked_is_refused(self, world: World) -> None:
        client = await world.client()
        for query in (
            {"kind": "thing"},
            {"op": "dance"},
            {"limit": 0},
            {"limit": 100_000},
            {"cursor": "not one of ours"},
            {"colour": "red"},
        ):
            reply = await client.request("discover", body=query)
            assert reply["status"] == "rejected", query
            assert reply["error"]["code"] in ("bad_request", "invalid_value", "out_of_range")

    @proves("discover.generation")
    async def test_its_generation_rises_with_the_tree(self, world: World) -> None:
        client = await world.client()
        before = (await client.request("discover"))["body"]["generation"]
        new = Resource(name="sensor/new", description="New.", value=quantity("1"), live=True)
        world.robot().host.declare(new)
        assert (await client.request("discover"))["body"]["generation"] > before
        assert "sensor/new" in _names(await _found(client))
        world.robot().host.withdraw("sensor/new")
        assert "sensor/new" not in _names(await _found(client))
        assert (await client.request("read", "/sensor/new"))["error"]["code"] == "unknown_path"

    @proves("discover.deadman")
    async def test_it_tells_how_an_actuator_comes_to_rest(self, world: World) -> None:
        (drive,) = await _found(await world.client(), "/actuator/drive")
        assert (drive["max_age"], drive["valid_for"]) == (1.0, 0.2)
        assert drive["safe"]["linear"]["x"] == 0.0

    @proves("status.report")
    async def test_the_health_report_has_all_its_parts(self, world: World) -> None:
        client = await world.client()
        for reply in (
            await client.request("status"),
            await client.request("read", "/system/status"),
        ):
            body = reply["body"]
            assert body.keys() >= {
                *("state", "version", "uptime", "started", "process", "host", "backends"),
                *("transports", "adapters", "sessions", "subscriptions", "commands"),
                *("queues", "warnings"),
            }
            assert body["process"].keys() >= {"cpu", "rss", "threads", "open_files"}
            assert body["queues"].keys() >= {"depth", "high_water", "dropped", "by_session"}

    @proves("status.backends")
    async def test_a_backend_that_is_not_there_is_down_in_it(self, world: World) -> None:
        report = (await (await world.client()).request("status"))["body"]
        backends = {backend["name"]: backend for backend in report["backends"]}
        assert report["state"] == "degraded"
        assert backends["main"]["state"] == "ready"
        assert (backends["main"]["plugin"], backends["main"]["tenant"]) == ("wire-robot", "alpha")
        assert backends["main"]["resources"] > 20
        assert backends["ghost"]["state"] == "down"
        assert "nobody answers" in backends["ghost"]["last_error"]

    @proves("status.counts")
    async def test_it_counts_commands_as_they_end(self, world: World) -> None:
        client = await world.client()
        for mode in ("quick", "quick", "refuse"):
            await client.request("execute", "/action/go", body={"distance": 1, "mode": mode})
        counts = (await client.request("status"))["body"]["commands"]
        assert (counts["running"], counts["queued"]) == (0, 0)
        assert (counts["completed"], counts["failed"]) == (2, 1)

    @proves("status.stream")
    async def test_it_can_be_subscribed_to(self, world: World) -> None:
        client = await world.client()
        id_ = await client.subscribe("/system/status", rate=10)
        assert (await client.update(id_))["body"]["state"] == "degraded"

        async def ticking() -> bool:
            return (await client.update(id_))["seq"] > 1

        await eventually(ticking, "the report goes on")
