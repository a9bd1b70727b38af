"""The calls of HTTP beside `POST /messages`, each with a requirement of its own."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from typing import Any, ClassVar

import httpx
import pytest

from conformance.wires import BASE, LISTENER, MEDIA, HttpClient, address, bearer
from rcp_gateway.server import Server
from rcp_gateway.testing import OPERATOR, Client, decode, encode, eventually, proves
from rcp_gateway.testing.wire import Wire, World
from rcp_kernel.errors import BY_CODE
from rcp_kernel.types import Point, PoseStamped
from rcp_kernel.values import Encoding

WAIT = {"distance": 4.0, "mode": "wait"}


class TestRest(Wire):
    offers = frozenset({"rest"})
    transports: ClassVar = {"asgi": LISTENER, "http": {}, "sse": {}}

    async def connect(self, server: Server, token: str | None, encoding: Encoding) -> Client:
        return HttpClient(server, token, encoding)

    @pytest.fixture
    async def http(self, world: World) -> AsyncGenerator[httpx.AsyncClient]:
        """A client of the calls under /rcp/v1."""
        url = address(world.server) + BASE
        headers = bearer(OPERATOR)
        async with httpx.AsyncClient(base_url=url, headers=headers, trust_env=False) as client:
            yield client

    @proves("rest.read")
    async def test_get_reads(self, world: World, http: httpx.AsyncClient) -> None:
        world.publish("sensor/pose", PoseStamped(Point(1.0, 2.0, 0.0), frame_id="odom"))
        reply = await http.get("/context/sensor/pose")
        assert reply.status_code == 200
        assert reply.json()["body"]["position"]["x"] == 1.0
        assert reply.json()["path"] == "/tenant/alpha/sensor/pose"
        cut = await http.get("/context/tenant/alpha/sensor/pose?fields=position.x,frame_id")
        assert cut.json()["body"] == {"position": {"x": 1.0}, "frame_id": "odom"}
        many = await http.get("/context/sensor/*?deadline=0.5")
        found = {item["path"]: item for item in many.json()["body"]}
        assert found["/tenant/alpha/sensor/pose"]["status"] == "completed"

    @proves("rest.opening")
    async def test_what_may_yet_come_is_503_with_a_time_to_ask_again(
        self, world: World, http: httpx.AsyncClient
    ) -> None:
        for url in ("/context/sensor/ghost/arrived", "/events?path=/sensor/ghost/arrived"):
            reply = await http.get(url)
            assert (reply.status_code, int(reply.headers["retry-after"])) == (503, 1), url
            assert reply.json()["error"]["code"] == "adapter_unavailable"
        before = await http.get("/discovery?schemas=false&limit=1")
        assert before.json()["body"]["complete"] is False
        await world.arrive()
        tag = {"If-None-Match": before.headers["etag"]}
        after = await http.get("/discovery?schemas=false&limit=1", headers=tag)
        assert (after.status_code, after.json()["body"].get("complete")) == (200, None)
        gone = await http.get("/context/sensor/ghost/never")
        assert (gone.status_code, gone.json()["error"]["code"]) == (404, "unknown_path")

    @proves("rest.write")
    async def test_put_writes(self, world: World, http: httpx.AsyncClient) -> None:
        reply = await http.put("/context/param/limit", json=2.0)
        assert (reply.status_code, reply.json()["body"]) == (200, 2.0)
        assert world.robot().values["param/limit"] == 2.0
        bad = await http.put("/context/param/limit", json=9.0)
        assert (bad.status_code, bad.json()["error"]["code"]) == (422, "out_of_range")
        assert world.robot().values["param/limit"] == 2.0

    @proves("rest.execute")
    async def test_post_executes(self, world: World, http: httpx.AsyncClient) -> None:
        begun = await http.post("/context/action/go", json=WAIT)
        assert begun.status_code == 202
        assert begun.headers["location"] == f"{BASE}/commands/{begun.json()['command']}"
        assert begun.json()["status"] in ("accepted", "in_progress")
        world.robot().release.set()
        for headers, url in (({"Prefer": "wait=5"}, ""), ({}, "?wait=5")):
            done = await http.post(f"/context/action/beside{url}", json=WAIT, headers=headers)
            assert (done.status_code, done.json()["body"]) == (200, 4.0)

    @proves("rest.commands")
    async def test_commands_are_listed_looked_at_and_cancelled(
        self, world: World, http: httpx.AsyncClient
    ) -> None:
        id_ = (await http.post("/context/action/go", json=WAIT)).json()["command"]
        listed = (await http.get("/commands")).json()["body"]
        assert [command["command"] for command in listed] == [id_]
        assert (await http.get(f"/commands/{id_}")).json()["body"]["path"].endswith("/action/go")
        assert (await http.delete(f"/commands/{id_}")).status_code == 200

        async def cancelled() -> bool:
            body = (await http.get(f"/commands/{id_}")).json()["body"]
            return body["status"] == "cancelled"

        await eventually(cancelled, "the command is cancelled")
        assert (await http.get("/commands/cmd-none")).status_code == 404

    @proves("rest.command-events")
    async def test_the_replies_of_a_command_are_a_stream(
        self, world: World, http: httpx.AsyncClient
    ) -> None:
        id_ = (await http.post("/context/action/go", json=WAIT)).json()["command"]
        world.robot().release.set()
        async with asyncio.timeout(60):
            text = (await http.get(f"/commands/{id_}/events")).text
        assert text.count("event: reply") >= 2
        assert '"status":"completed"' in text.strip().splitlines()[-1]

    @proves("rest.discovery")
    async def test_discovery_answers_as_discover_does(
        self, world: World, http: httpx.AsyncClient
    ) -> None:
        query = {"path": "/sensor/**", "kind": "sensor", "op": "read", "q": "tank", "limit": "2"}
        body = (await http.get("/discovery", params=query)).json()["body"]
        assert [item["path"] for item in body["resources"]] == [
            "/tenant/alpha/sensor/drone1/level",
            "/tenant/alpha/sensor/ghost/level",
        ]
        rest = await http.get("/discovery", params={**query, "cursor": body["cursor"]})
        assert len(rest.json()["body"]["resources"]) == 1
        assert (await http.get("/discovery?kind=thing")).status_code == 422
        assert (await http.get("/discovery?colour=red")).status_code == 400

    @proves("rest.schemas")
    async def test_schemas_stand_under_their_ids(
        self, world: World, http: httpx.AsyncClient
    ) -> None:
        found = (await http.get("/discovery?path=/sensor/level")).json()["body"]["resources"][0]
        id_ = found["schema_ids"]["value"]
        assert id_ in str((await http.get("/schemas")).json()["body"])
        assert (await http.get(f"/schemas/{id_}")).json()["body"] == found["schemas"]["value"]
        assert (await http.get("/schemas/nothing")).status_code == 404

    @proves("rest.status")
    async def test_the_health_report_comes_once_or_as_a_stream(
        self, world: World, http: httpx.AsyncClient
    ) -> None:
        assert (await http.get("/status")).json()["body"]["state"] == "degraded"
        async with asyncio.timeout(60), http.stream("GET", "/status/events?count=1") as stream:
            text = "".join([line async for line in stream.aiter_lines()])
        assert '"state":"degraded"' in text

    @proves("rest.health")
    async def test_the_probes_stand_at_the_root(
        self, world: World, http: httpx.AsyncClient
    ) -> None:
        root = address(world.server)
        assert (await http.get(root + "/healthz")).status_code == 200
        ready = await http.get(root + "/readyz")
        assert ready.status_code == 503
        assert "ghost" in ready.text

    @proves("rest.metrics")
    async def test_the_metrics_are_those_of_the_contract(
        self, world: World, http: httpx.AsyncClient
    ) -> None:
        world.publish("sensor/level", 1.0)
        await http.get("/context/sensor/level")
        await http.post("/context/action/go?wait=5", json={"distance": 1})
        text = (await http.get(address(world.server) + "/metrics")).text
        for name in (
            *("rcp_build_info", "rcp_uptime_seconds", "rcp_requests_total", "rcp_request_seconds"),
            *("rcp_samples_total", "rcp_updates_total", "rcp_dropped_total", "rcp_sessions"),
            *("rcp_subscriptions", "rcp_commands_total", "rcp_command_seconds", "rcp_queue_depth"),
            *("rcp_event_loop_lag_seconds", "rcp_resource_age_seconds"),
        ):
            assert f"# HELP {name} " in text, name
        assert 'rcp_backend_up{backend="main",tenant="alpha"} 1.0' in text
        assert 'rcp_backend_up{backend="ghost",tenant="alpha"} 0.0' in text

    @proves("rest.openapi")
    async def test_openapi_describes_the_live_resources(
        self, world: World, http: httpx.AsyncClient
    ) -> None:
        document = (await http.get("/openapi.json")).json()
        assert document == (await http.get(address(world.server) + "/openapi.json")).json()
        assert document["openapi"].startswith("3.1")
        paths = document["paths"]
        assert f"{BASE}/messages" in paths
        level = next(item for path, item in paths.items() if path.endswith("alpha/sensor/level"))
        assert "get" in level
        assert "put" not in level

    @proves("rest.fields")
    async def test_fields_of_the_envelope_travel_as_parameters_or_headers(
        self, world: World, http: httpx.AsyncClient
    ) -> None:
        late = await http.get("/context/sensor/silent?deadline=0.1&id=q-1&x-note=n")
        assert (late.status_code, late.json()["id"], late.json()["x-note"]) == (504, "q-1", "n")
        assert (await http.get("/context/sensor/asked", headers={"X-RCP-Id": "h-1"})).json()[
            "id"
        ] == "h-1"
        dry = await http.put("/context/param/limit?dry_run=true", json=2.0)
        assert dry.json()["dry_run"] is True
        for _ in range(2):
            headers = {"Idempotency-Key": "k"}
            await http.put("/context/param/limit", json=2.0, headers=headers)
        assert len(world.robot().writes) == 1
        assert (await http.get("/context/sensor/level?version=3")).json()["error"]["code"] == (
            "version_unsupported"
        )

    @proves("rest.codes")
    async def test_every_code_has_its_status(self, world: World, http: httpx.AsyncClient) -> None:
        seen: set[str] = set()
        requests: list[tuple[str, str, Any]] = [
            ("GET", "/context/sensor/le%20vel", None),
            ("GET", "/context/sensor/absent", None),
            ("PUT", "/context/sensor/level", 1),
            ("PUT", "/context/param/limit", "fast"),
            ("PUT", "/context/param/limit", 9),
            ("PUT", "/context/param/refused", 1),
            ("GET", "/context/sensor/late", None),
            ("GET", "/context/sensor/crashed", None),
            ("GET", "/context/sensor/ghost/level", None),
            ("GET", "/context/sensor/silent?deadline=0.1", None),
            ("POST", "/context/action/go", WAIT),
            ("POST", "/context/action/go", WAIT),
        ]
        for method, url, body in requests:
            reply = await http.request(method, url, json=body)
            error = reply.json().get("error")
            if error is None:
                assert reply.status_code == 202
                continue
            seen.add(error["code"])
            assert reply.status_code == BY_CODE[error["code"]].http, (url, error)
        assert len(seen) == 11, seen

    @proves("rest.encodings")
    async def test_content_type_and_accept_choose_the_encoding(
        self, world: World, http: httpx.AsyncClient
    ) -> None:
        for sent in Encoding:
            for wanted in Encoding:
                headers = {"Content-Type": MEDIA[sent], "Accept": MEDIA[wanted]}
                reply = await http.put(
                    "/context/param/limit", content=encode(1.25, sent), headers=headers
                )
                assert reply.headers["content-type"].startswith(MEDIA[wanted])
                assert decode(reply.content, wanted)["body"] == 1.25
        odd = await http.get("/context/sensor/level", headers={"Accept": "text/html"})
        assert odd.status_code in (400, 406)
        strange = {"Content-Type": "text/csv"}
        put = await http.put("/context/param/limit", content=b"1", headers=strange)
        assert put.status_code in (400, 415)

    @proves("rest.etag")
    async def test_an_etag_spares_what_has_not_changed(
        self, world: World, http: httpx.AsyncClient
    ) -> None:
        world.publish("sensor/level", 1.0)
        host = world.robot().host
        for url, change in (
            ("/context/sensor/level", lambda: host.publish("sensor/level", 2.0)),
            ("/discovery", lambda: host.withdraw("sensor/asked")),
        ):
            first = await http.get(url)
            headers = {"If-None-Match": first.headers["etag"]}
            assert (await http.get(url, headers=headers)).status_code == 304
            change()
            assert (await http.get(url, headers=headers)).status_code == 200

    @proves("rest.coding")
    async def test_longer_answers_are_compressed(
        self, world: World, http: httpx.AsyncClient
    ) -> None:
        plain = await http.get("/discovery", headers={"Accept-Encoding": "identity"})
        assert "content-encoding" not in plain.headers
        for coding in ("gzip", "zstd"):
            reply = await http.get("/discovery", headers={"Accept-Encoding": coding})
            assert reply.headers["content-encoding"] == coding
            assert reply.json()["body"] == plain.json()["body"]

    @proves("rest.range")
    async def test_bytes_can_be_read_by_range(self, world: World, http: httpx.AsyncClient) -> None:
        await http.put("/context/param/parcel", json={"data": "AAECAwQFBgc="})
        url = "/context/param/parcel?fields=data"
        headers = {"Accept": "application/octet-stream", "Range": "bytes=2-4"}
        part = await http.get(url, headers=headers)
        assert (part.status_code, part.content) == (206, bytes((2, 3, 4)))
        assert part.headers["content-range"] == "bytes 2-4/8"
        headers["Range"] = "bytes=90-"
        assert (await http.get(url, headers=headers)).status_code == 416

    @proves("rest.proof")
    async def test_a_key_that_is_not_known_is_refused(
        self, world: World, http: httpx.AsyncClient
    ) -> None:
        for url in ("/context/sensor/level", "/events?path=/sensor/level", "/discovery"):
            reply = await http.get(url, headers=bearer("not-a-known-key"))
            assert (reply.status_code, reply.json()["error"]["code"]) == (401, "unauthenticated")
            assert reply.headers["www-authenticate"].startswith("Bearer")

    @proves("rest.stream-resume")
    async def test_last_event_id_resumes_a_stream(
        self, world: World, http: httpx.AsyncClient
    ) -> None:
        query = "/events?path=/sensor/level&reliability=reliable&initial=false"
        ids, seqs = list[str](), list[int]()
        for round_ in range(3):
            headers = {"Last-Event-ID": ids[-1]} if ids else {}
            async with asyncio.timeout(60), http.stream("GET", query, headers=headers) as stream:
                world.publish("sensor/level", *map(float, range(3)))
                wanted = 3 * (round_ + 1) - 1  # cut before the last one: it comes again
                async for line in stream.aiter_lines():
                    if line.startswith("id: "):
                        ids.append(line[4:])
                    if line.startswith("data: "):
                        seqs += [s for s in [json.loads(line[6:]).get("seq")] if "update" in line]
                    if seqs and seqs[-1] == wanted:
                        break
        assert seqs == list(range(1, 9))
