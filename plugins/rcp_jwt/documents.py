"""Documents of issuers, and requests to them, over HTTP.

Servers are trusted as little as possible: sizes and times are bounded, and redirects are not followed.
"""

from __future__ import annotations

import asyncio
import http.client
import socket
import ssl
import threading
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import msgspec

from rcp_protocol.timeouts import timeout

__all__ = ["Answer", "Unreachable", "fetch", "post", "read_document"]

_LONGEST = 512 * 1024  # bytes of a document
_PATIENCE = 5.0  # s for a whole request
_HEADERS = {"Accept": "application/json", "User-Agent": "rcp-gateway"}


class Unreachable(Exception):
    """The document could not be fetched, or is invalid."""


class Answer(NamedTuple):
    """A complete response."""

    status: int
    body: bytes


def read_document(data: bytes) -> Any:
    """Parse JSON.

    :raises ValueError: it is invalid.
    """
    try:
        return msgspec.json.decode(data)
    except (msgspec.DecodeError, RecursionError):
        raise ValueError("it is not JSON") from None


async def fetch(url: str) -> bytes:
    """Fetch a document in a worker thread.

    :raises Unreachable: it failed, took too long, was too large, or had a status other than 200.
    """
    answer = await _answer(_Call(url, "GET", {}))
    if answer.status != 200:
        raise Unreachable(f"the answer has status {answer.status}")
    return answer.body


async def post(url: str, form: bytes, headers: Mapping[str, str]) -> Answer:
    """Send a form in a worker thread, and return the response of whatever status.

    :raises Unreachable: it failed, took too long, or the response was too large.
    """
    media = {"Content-Type": "application/x-www-form-urlencoded"}
    return await _answer(_Call(url, "POST", {**media, **headers}, form))


async def _answer(call: _Call) -> Answer:
    loop = asyncio.get_running_loop()
    done: asyncio.Future[Answer] = loop.create_future()

    def settle(answer: Answer | None, reason: str) -> None:
        if done.done():
            return
        if answer is None:
            done.set_exception(Unreachable(reason))
        else:
            done.set_result(answer)

    def work() -> None:
        answer, reason = None, ""
        try:
            answer = call.run()
        except Unreachable as error:
            reason = str(error)
        except (OSError, http.client.HTTPException, ValueError) as error:
            reason = type(error).__name__
        with suppress(RuntimeError):  # the event loop has ended, and with it the caller
            loop.call_soon_threadsafe(settle, answer, reason)

    threading.Thread(target=work, name="rcp-fetch", daemon=True).start()
    try:
        async with timeout(_PATIENCE):
            return await done
    except TimeoutError:
        raise Unreachable(f"no complete answer within {_PATIENCE:g} s") from None
    finally:
        call.stop()


def _connection(scheme: str, host: str, port: int | None) -> http.client.HTTPConnection:
    if scheme != "https":
        return http.client.HTTPConnection(host, port, timeout=_PATIENCE)
    context = ssl.create_default_context()
    return http.client.HTTPSConnection(host, port, timeout=_PATIENCE, context=context)


class _Call:
    """One request that another thread can abort."""

    def __init__(
        self, url: str, method: str, headers: Mapping[str, str], body: bytes | None = None
    ) -> None:
        parts = urlsplit(url)
        self._method = method
        self._headers = {**_HEADERS, **headers}
        self._body = body
        self._target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        host = parts.hostname or ""
        self._open = partial(_connection, parts.scheme, host, parts.port)
        self._connection: http.client.HTTPConnection | None = None
        self._stopped = False

    def run(self) -> Answer:
        """Do it; in a worker thread, where reading the certificates delays nobody."""
        connection = self._connection = self._open()
        if self._stopped:
            raise Unreachable("it was given up")
        try:
            connection.request(self._method, self._target, self._body, self._headers)
            response = connection.getresponse()
            data = response.read(_LONGEST + 1)
        finally:
            connection.close()
        if len(data) > _LONGEST:
            raise Unreachable(f"the answer is longer than {_LONGEST} bytes")
        return Answer(response.status, data)

    def stop(self) -> None:
        """Wake a thread that still waits for the server."""
        self._stopped = True
        held: Any = None if self._connection is None else self._connection.sock
        if held is not None:
            with suppress(OSError):
                held.shutdown(socket.SHUT_RDWR)
