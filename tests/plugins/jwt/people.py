"""A browser that logs in at an issuer which does as a test says."""

from __future__ import annotations

import json
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any
from urllib.parse import parse_qs, urlsplit

import httpx

from issuer import Issuer
from openid import CLIENT, login_table, patience
from ports import free_port
from transports.robot import Site, site

__all__ = ["BACK", "BEGIN", "LOGIN", "TOP", "back", "people_logging_in", "sent"]

LOGIN = "/rcp/v1/login"
BEGIN = "/rcp/v1/login/oidc/house"
BACK = BEGIN + "/callback"
TOP = "anonymous = false\n"


@asynccontextmanager
async def people_logging_in(issuer: Issuer, more: str = "", **options: Any) -> AsyncGenerator[Site]:
    issuer.more |= {
        "authorization_endpoint": issuer.url + "/authorize?tenant=1",
        "token_endpoint": issuer.url + "/token",
    }
    port = free_port()
    text = login_table(issuer.url, port) + more
    with patience():
        async with site(port=port, top=TOP, more=text, **options) as made:
            yield made


async def sent(browser: httpx.AsyncClient, **query: str) -> dict[str, str]:
    """Begin to log in; return what the issuer is sent."""
    answer = await browser.get(BEGIN, params=query)
    assert answer.status_code == 303, answer.text
    asked = parse_qs(urlsplit(answer.headers["location"]).query)
    return {name: values[0] for name, values in asked.items()}


async def back(
    browser: httpx.AsyncClient, issuer: Issuer, token: str | None = None, **changed: Any
) -> httpx.Response:
    """Log in; the issuer gives out a token, the one that is due but for what is changed."""
    asked = await sent(browser)
    due = {"aud": CLIENT, "nonce": asked["nonce"], "groups": ["drivers"]}
    made = token or issuer.token(**{**due, **changed})
    issuer.exchanged = json.dumps({"id_token": made, "token_type": "Bearer"}).encode()
    return await browser.get(BACK, params={"code": "c", "state": asked["state"]})
