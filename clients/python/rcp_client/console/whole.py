"""Requests of the principal as a whole, outside any session: single requests over HTTP."""

from __future__ import annotations

import asyncio
import http.client
import json
import urllib.error
import urllib.request
from typing import Any

import msgspec

from rcp_client.client import Client
from rcp_client.console import unwaited
from rcp_client.errors import ConnectionLost, error_of, unknown_outcome
from rcp_client.messages import Reply
from rcp_client.requests import repeatable
from rcp_client.settings import MARGIN
from rcp_protocol.errors import RcpError
from rcp_protocol.timeouts import timeout

__all__ = ["Unanswered", "post", "request"]


async def request(client: Client, envelope: dict[str, Any]) -> Reply:
    """Send one request outside the client's session and return its final reply.

    :raises RcpError: the reply contains an error, or none came.
    """
    # The gateway's own reply is more specific than a time-out here.
    limit = envelope.setdefault("deadline", client.settings.deadline) + MARGIN
    try:
        async with timeout(limit):  # that of a socket covers no name that is looked up
            reply = await asyncio.wrap_future(unwaited.start(_post, client, envelope))
    except TimeoutError:
        late = f"{client.channel.address.url} did not answer within {limit:g} s"
        raise _lost(envelope, Unanswered(late)) from None
    error = error_of(reply)
    if error is not None:
        raise error
    return reply


def _post(client: Client, envelope: dict[str, Any]) -> Reply:
    wanted = {"Accept": "application/json"}
    try:
        data = post(client, "/rcp/v1/messages", envelope, envelope["deadline"], wanted)
    except Unanswered as lost:
        raise _lost(envelope, lost) from lost.__cause__
    return msgspec.json.decode(data, type=Reply)


def _lost(envelope: dict[str, Any], lost: Unanswered) -> RcpError:
    return lost if repeatable(envelope, keys=True) else unknown_outcome(lost)


class Unanswered(ConnectionLost):
    """A request may have arrived, and has no answer."""


def post(
    client: Client, path: str, body: dict[str, Any], deadline: float, headers: dict[str, str]
) -> bytes:
    """Post JSON to the client's gateway as its principal; return the body of the answer. Blocks.

    :raises ConnectionLost: the gateway cannot be reached.
    :raises Unanswered: it did not answer.
    """
    settings, address = client.settings, client.channel.address
    sent = {"Content-Type": "application/json", **headers}
    if (token := settings.proof()) is not None:
        sent["Authorization"] = f"Bearer {token}"
    url = address.url + path
    http_request = urllib.request.Request(url, json.dumps(body).encode(), sent)  # noqa: S310
    try:
        with urllib.request.urlopen(  # noqa: S310 - the address of the client's own connection
            http_request,
            timeout=deadline + MARGIN,
            context=settings.ssl if address.secure else None,
        ) as answer:
            return answer.read()
    except urllib.error.HTTPError as refusal:
        return refusal.read()
    except urllib.error.URLError as error:  # it could not be sent
        raise ConnectionLost(f"cannot reach {address.url}: {error}") from error
    except (OSError, http.client.HTTPException) as error:
        raise Unanswered(f"{address.url} did not answer: {error!r}") from error
