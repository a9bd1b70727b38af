"""Downloads of zone sets, only from where the configuration allows.

A link comes from whoever may publish at the broker. So the server must be one that is named, nothing
is redirected, and size and time are bounded.
"""

from __future__ import annotations

import hashlib
import ssl
from collections.abc import Collection

import httpx

from rcp_protocol.timeouts import timeout
from rcp_vda5050.faults import DownloadFailed

__all__ = ["LARGEST", "Downloads"]

LARGEST = 4 << 20  # bytes
_LONGEST = 30.0  # s of a whole download
_SILENCE = 10.0  # s without a byte
_DIGESTS = {64: "sha256", 128: "sha512"}
"""By their length in hexadecimal digits: the standard does not say which it means."""
_HEADERS = {"Accept": "application/json", "Accept-Encoding": "identity"}


class Downloads:
    """Downloads from some origins: scheme, host and port."""

    def __init__(self, origins: Collection[str], trusted: ssl.SSLContext) -> None:
        self._origins = {_origin(httpx.URL(each)): each for each in origins}
        self._trusted = trusted

    async def fetch(self, link: str, digest: str | None) -> bytes:
        """Return a document, which has the digest if there is one.

        :raises DownloadFailed: it is not allowed, or failed, or is another document.
        """
        algorithm = None if digest is None else _algorithm(digest)
        url = self._checked(link)
        try:
            async with timeout(_LONGEST):
                data = await self._get(url)
        except TimeoutError:
            raise DownloadFailed(f"the download took more than {_LONGEST:g} s") from None
        except (httpx.HTTPError, OSError) as error:
            raise DownloadFailed(
                f"the download failed: {type(error).__name__} {error}"[:300]
            ) from error
        if algorithm is not None and digest is not None:
            found = hashlib.new(algorithm, data).hexdigest()
            if found != digest.lower():
                raise DownloadFailed(f"the {algorithm} of what was downloaded is {found}")
        return data

    def _checked(self, link: str) -> httpx.URL:
        try:
            url = httpx.URL(link)
        except httpx.InvalidURL as error:
            raise DownloadFailed(f"the link is no URL: {error}") from error
        if _origin(url) not in self._origins:
            there = ", ".join(self._origins.values())
            raise DownloadFailed(
                f"downloads from {_told(url)} are not allowed; allowed are: {there}"
            )
        if url.userinfo:
            raise DownloadFailed("the link has a user name, which nothing here sends")
        return url

    async def _get(self, url: httpx.URL) -> bytes:
        found = bytearray()
        async with (
            httpx.AsyncClient(
                timeout=_SILENCE, follow_redirects=False, trust_env=False, verify=self._trusted
            ) as client,
            client.stream("GET", url, headers=_HEADERS) as answer,
        ):
            if answer.status_code != 200:
                more = ": redirects are not followed" if answer.is_redirect else ""
                raise DownloadFailed(f"the server answered {answer.status_code}{more}")
            if answer.headers.get("content-encoding", "identity") != "identity":
                raise DownloadFailed("the server compresses, although it was asked not to")
            async for part in answer.aiter_raw():
                found += part
                if len(found) > LARGEST:
                    raise DownloadFailed(f"there are more than {LARGEST} bytes")
        return bytes(found)


def _origin(url: httpx.URL) -> tuple[str, str, int | None]:
    return url.scheme, url.host, url.port or {"http": 80, "https": 443}.get(url.scheme)


def _told(url: httpx.URL) -> str:
    return f"{url.scheme}://{url.netloc.decode('ascii', 'replace')}"[:200]


def _algorithm(digest: str) -> str:
    found = _DIGESTS.get(len(digest))
    if found is None:
        raise DownloadFailed(
            f"the hash has {len(digest)} characters; SHA-256 (64) and SHA-512 (128) can be checked"
        )
    return found
