"""Requests over HTTP: fields, commands, failures and envelopes."""

from __future__ import annotations

from typing import Any

import cbor2
import httpx
import pytest

from rcp_kernel.errors import AdapterUnavailable, Cancelled, DeviceRejected, DeviceTimeout
from transports.http_requests import CONTEXT, POSE, error
from transports.robot import Site

pytestmark = pytest.mark.anyio


async def test_fields_come_as_parameters_and_headers(http: httpx.AsyncClient) -> None:
    path = f"{CONTEXT}/param/limit"
    dry = await http.put(f"{path}?dry_run=true&id=7&x-who=me", content=b"2")
    assert dry.json()["dry_run"] is True
    assert (dry.json()["id"], dry.json()["x-who"]) == ("7", "me")
    first = await http.put(path, content=b"2", headers={"idempotency-key": "k", "x-rcp-id": "a"})
    again = await http.put(path, content=b"2", headers={"idempotency-key": "k", "x-rcp-id": "b"})
    assert (first.json()["seq"], first.json()["id"]) == (again.json()["seq"], "a")
    assert again.json()["id"] == "b"
    other = await http.put(path, content=b"1", headers={"idempotency-key": "k"})
    assert (other.status_code, error(other)) == (409, "duplicate_request")


@pytest.mark.parametrize(
    "query",
    ["deadline=soon", "deadline=-1", "dry_run=perhaps", "id=1&id=2", "unknown=1", "version=2",
     "timestamp=yesterday", "deadline=nan", "id="],
)  # fmt: skip
async def test_a_parameter_that_is_wrong_is_named(http: httpx.AsyncClient, query: str) -> None:
    response = await http.get(f"{POSE}?{query}")
    assert response.status_code == 400, response.text
    assert error(response) in ("bad_request", "version_unsupported")


async def test_a_deadline_holds(http: httpx.AsyncClient) -> None:
    response = await http.get(f"{CONTEXT}/sensor/silent?deadline=0.05")
    assert response.status_code in (503, 504)


async def test_fields_are_projected_and_patterns_read_many(http: httpx.AsyncClient) -> None:
    one = await http.get(f"{POSE}?fields=position.x")
    assert one.json()["body"] == {"position": {"x": 1.0}}
    many = await http.get(f"{CONTEXT}/tenant/*/sensor/pose")
    assert [item["path"] for item in many.json()["body"]] == [
        "/tenant/alpha/sensor/pose",
        "/tenant/beta/sensor/pose",
    ]


async def test_a_tenant_is_named_by_header_or_parameter(http: httpx.AsyncClient) -> None:
    for one in ({"headers": {"x-rcp-tenant": "beta"}}, {"params": {"tenant": "beta"}}):
        response = await http.get(f"{CONTEXT}/sensor/pose", **one)
        assert response.json()["path"] == "/tenant/beta/sensor/pose"
    foreign = await http.get(
        f"{CONTEXT}/sensor/pose?tenant=alpha",
        headers={"authorization": "Bearer key-of-tenant-beta"},
    )
    assert foreign.status_code == 403


async def test_execute_answers_at_once_and_its_command_can_be_followed(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    response = await http.post(f"{CONTEXT}/action/go", json=4)
    assert (response.status_code, response.json()["status"]) == (202, "accepted")
    place = response.headers["location"]
    assert place == f"/rcp/v1/commands/{response.json()['command']}"
    await gateway.robot.started.get()
    state = (await http.get(place)).json()["body"]
    assert (state["status"], state["progress"]) == ("in_progress", 0.5)
    busy = await http.post(f"{CONTEXT}/action/go", json=4)
    assert (busy.status_code, error(busy)) == (409, "already_running")
    gone = await http.delete(place)
    assert gone.json()["body"] == {"cancelled": [response.json()["command"]]}
    listed = await http.get("/rcp/v1/commands?limit=1")
    assert listed.json()["body"][0]["command"] == response.json()["command"]
    assert "history" not in listed.json()["body"][0]


@pytest.mark.parametrize("how", [{"params": {"wait": "5"}}, {"headers": {"prefer": "wait=5"}}])
async def test_execute_may_wait_for_the_end(
    http: httpx.AsyncClient, gateway: Site, how: dict[str, Any]
) -> None:
    gateway.robot.release.set()
    response = await http.post(f"{CONTEXT}/action/go", json=4, **how)
    assert (response.status_code, response.json()["body"]) == (200, 4)


async def test_waiting_in_vain_ends_with_what_there_is(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    response = await http.post(f"{CONTEXT}/action/go?wait=0.05", json=4)
    assert (response.status_code, response.json()["status"]) == (202, "in_progress")
    assert response.headers["location"].endswith(response.json()["command"])
    failed = await http.post(f"{CONTEXT}/action/go?wait=5&tenant=beta", json=400)
    assert (failed.status_code, error(failed)) == (502, "device_rejected")


@pytest.mark.parametrize(
    ("trouble", "status", "code"),
    [
        (DeviceRejected, 502, "device_rejected"),
        (DeviceTimeout, 504, "device_timeout"),
        (AdapterUnavailable, 503, "adapter_unavailable"),
        (Cancelled, 499, "cancelled"),
        (ZeroDivisionError, 500, "internal"),
    ],
)
@pytest.mark.parametrize("call", ["write", "execute", "posted", "service"])
async def test_what_has_failed_is_never_a_2xx(
    http: httpx.AsyncClient,
    gateway: Site,
    trouble: type[Exception],
    status: int,
    code: str,
    call: str,
) -> None:
    async def fail(value: Any, progress: Any = None) -> Any:
        raise trouble("the way is blocked")

    async def stumble(value: Any, progress: Any) -> Any:
        progress(1.0, fraction=0.5)
        await fail(value)

    gateway.robot.takes["param/limit"] = fail
    gateway.robot.behaviours |= {"action/go": stumble, "service/add": fail}
    message = {"type": "execute", "path": "/action/go", "body": 4, "deadline": 5}
    for key in ("first", "first", "again"):  # a repeat under a key tells the same
        headers = {"idempotency-key": key}
        if call == "write":
            response = await http.put(f"{CONTEXT}/param/limit", json=1.0, headers=headers)
        elif call == "posted":
            response = await http.post("/rcp/v1/messages", json=message, headers=headers)
        else:
            path = {"execute": "action/go", "service": "service/add"}[call]
            response = await http.post(f"{CONTEXT}/{path}?wait=5", json=4, headers=headers)
        assert (response.status_code, error(response)) == (status, code)
        assert response.json()["status"] in ("failed", "rejected", "cancelled")
    if call != "write":  # the lookup of a failed command has not failed
        found = await http.get(response.headers["location"])
        assert (found.status_code, found.json()["body"]["error"]["code"]) == (200, code)


async def test_any_envelope_may_be_posted(http: httpx.AsyncClient) -> None:
    async def post(**envelope: Any) -> httpx.Response:
        return await http.post("/rcp/v1/messages", json=envelope)

    assert (await post(type="ping", id="1")).json()["id"] == "1"
    added = await post(type="execute", path="/service/add", body=1)
    assert (added.status_code, added.json()["body"]) == (200, 2)
    started = await post(type="execute", path="/action/go", body=1)
    assert (started.status_code, started.json()["status"]) == (202, "accepted")
    late = await post(type="execute", path="/tenant/beta/action/go", body=1, deadline=0.05)
    assert (late.status_code, error(late)) == (504, "deadline_exceeded")
    batch = await post(type="batch", body=[{"type": "ping", "id": "a"}, {"type": "fly"}])
    assert [part["status"] for part in batch.json()["body"]] == ["completed", "rejected"]
    for wrong in ("subscribe", "hello"):
        refused = await post(type=wrong, id="9", path="/sensor/pose")
        assert (refused.status_code, refused.json()["id"]) == (405, "9")


async def test_an_envelope_in_cbor_is_answered_in_cbor(http: httpx.AsyncClient) -> None:
    response = await http.post(
        "/rcp/v1/messages",
        content=cbor2.dumps({"type": "read", "path": "/sensor/blob"}),
        headers={"content-type": "application/cbor"},
    )
    assert cbor2.loads(response.content)["body"] == b"0123456789"
