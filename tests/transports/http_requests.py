"""What tests of HTTP share."""

from __future__ import annotations

import httpx

POSE = "/rcp/v1/context/tenant/alpha/sensor/pose"
CONTEXT = "/rcp/v1/context"


def error(response: httpx.Response) -> str:
    return response.json()["error"]["code"]
