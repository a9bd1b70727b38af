"""Files of a gateway: downloaded piece by piece, and continued where an earlier try has ended."""

from __future__ import annotations

import http.client
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode

import msgspec

from rcp_client.client import Client
from rcp_client.errors import ConnectionLost, error_of
from rcp_client.messages import Reply

__all__ = ["download"]

_PIECE = 256 * 1024
_TRIES = 5
_PART = ".part"


class _Broken(Exception):
    """The connection was lost; with a validator, what is missing can be fetched."""

    def __init__(self, reason: str, etag: str | None) -> None:
        super().__init__(reason)
        self.etag = etag


def download(client: Client, path: str, query: dict[str, str], target: Path) -> int:
    """Download a file, and return its bytes. Blocks. Nothing is at `target` until it is complete.

    :raises RcpError: the gateway refuses.
    :raises ConnectionLost: it cannot be reached, or the connection is lost again and again.
    """
    url = quote(path) + (f"?{urlencode(query)}" if query else "")
    part = target.with_name(target.name + _PART)
    etag: str | None = None
    for attempt in range(_TRIES):
        done = part.stat().st_size if attempt and part.exists() else 0
        try:
            etag = _fetch(client, url, part, done, etag)
            break
        except _Broken as error:
            etag = error.etag
            if etag is None or attempt + 1 == _TRIES:
                part.unlink(missing_ok=True)
                raise ConnectionLost(f"the download of {target.name} broke off: {error}") from error
        except (OSError, http.client.HTTPException) as error:
            if etag is None or attempt + 1 == _TRIES:
                part.unlink(missing_ok=True)
                raise ConnectionLost(
                    f"cannot reach {client.settings.address.url}: {error}"
                ) from error
    size = part.stat().st_size
    part.replace(target)
    return size


def _fetch(client: Client, url: str, part: Path, done: int, etag: str | None) -> str | None:
    """Append what is missing; a file that has changed meanwhile is fetched from the beginning."""
    settings, address = client.settings, client.channel.address
    headers: dict[str, str] = {}
    if (token := settings.proof()) is not None:
        headers["Authorization"] = f"Bearer {token}"
    if settings.tenant is not None:
        headers["X-RCP-Tenant"] = settings.tenant
    if done and etag is not None:
        headers |= {"Range": f"bytes={done}-", "If-Range": etag}
    request = urllib.request.Request(address.url + url, headers=headers)  # noqa: S310
    try:
        answer: Any = urllib.request.urlopen(  # noqa: S310 - the address of the client's own connection
            request,
            timeout=settings.deadline,
            context=settings.ssl if address.secure else None,
        )
    except urllib.error.HTTPError as refusal:
        error = error_of(msgspec.json.decode(refusal.read(), type=Reply))
        raise error or ConnectionLost(f"{address.url} answered {refusal.code}") from None
    with answer, part.open("ab" if answer.status == 206 else "wb") as file:
        found = answer.headers.get("ETag")
        try:
            while piece := answer.read(_PIECE):
                file.write(piece)
            if answer.length:
                raise _Broken("the connection was closed", found)
        except (TimeoutError, ConnectionError, http.client.HTTPException) as error:
            raise _Broken(repr(error), found) from error
        return found
