"""Quotas over the real wires: what HTTP says of them, and what counts there."""

from __future__ import annotations

import math

import httpx
import pytest

from transports.robot import KEY, site

pytestmark = pytest.mark.anyio
SLOW = "\n[tenants.alpha.quota]\nrequests = 0.004\nburst = 2\n"
POSE = "/rcp/v1/context/tenant/alpha/sensor/pose"


@pytest.mark.parametrize(
    "path",
    [
        POSE,
        "/rcp/v1/status",
        "/rcp/v1/discovery",
        "/rcp/v1/schemas",
        "/rcp/v1/commands",
        "/rcp/v1/commands/none",
        "/rcp/v1/events?path=/sensor/pose",
        "/openapi.json",
        "/metrics",
    ],
)
async def test_every_call_counts_and_says_in_a_header_when_to_come_back(path: str) -> None:
    headers = {"authorization": f"Bearer {KEY}"}
    async with site(more=SLOW) as at, httpx.AsyncClient(base_url=at.url, headers=headers) as client:
        for _ in range(2):
            assert (await client.get(POSE)).status_code == 200
        refused = await client.get(path)
        assert refused.status_code == 429
        assert refused.json()["error"]["code"] == "rate_limited"
        after = refused.json()["error"]["retry_after"]
        assert 100.0 < after <= 250.001
        assert refused.headers["retry-after"] == str(math.ceil(after))
        stop = await client.post("/rcp/v1/context/system/estop", json={})
        assert stop.status_code in (200, 202), stop.text
        assert (await client.get("/healthz")).status_code == 200


async def test_an_event_stream_is_a_session_and_single_requests_are_none() -> None:
    headers = {"authorization": f"Bearer {KEY}"}
    quota = "\n[tenants.alpha.quota]\nsessions = 1\n"
    async with (
        site(more=quota) as at,
        httpx.AsyncClient(base_url=at.url, headers=headers) as client,
        client.stream("GET", "/rcp/v1/events?path=/sensor/pose") as stream,
    ):
        assert stream.status_code == 200
        refused = await client.get("/rcp/v1/events?path=/sensor/pose")
        assert (refused.status_code, refused.json()["error"]["code"]) == (503, "queue_full")
        assert (await client.get(POSE)).status_code == 200
