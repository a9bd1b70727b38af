"""Checks of a request's head before any processing (RFC 9112, sections 2 to 6).

A proxy in front of the gateway must interpret a request exactly like the gateway: anything
ambiguous is refused.
"""

from __future__ import annotations

import re

from rcp_kernel.errors import BadRequest, NotImplementedByRobot, PayloadTooLarge

__all__ = [
    "METHODS",
    "HeadTooLong",
    "Malformed",
    "TargetTooLong",
    "UnknownMethod",
    "check_head",
]

METHODS = b"GET, HEAD, PUT, POST, DELETE, OPTIONS"
"""The methods of the gateway as a whole: the `Allow` of `OPTIONS *`."""
_AUTHORITY = re.compile(
    rb"(?:\[[0-9A-Za-z:.%_~-]+\]|[0-9A-Za-z._~!$&'()*+,;=%-]*)(?::[0-9]{0,5})?\Z"
)
"""`uri-host [":" port]` (RFC 9110, 7.2), without user names."""
_ABSOLUTE = re.compile(rb"([A-Za-z][A-Za-z0-9+.-]*)://([^/?]*)(.*)\Z", re.DOTALL)
_VERSIONS = ("1.1", "1.0")
Headers = list[tuple[bytes, bytes]]


class Malformed(BadRequest):
    """The input is not an HTTP/1.1 request, or is ambiguous."""

    default_remedy = "Send an HTTP/1.1 request as RFC 9112 defines it."


class UnknownVersion(Malformed):
    """The HTTP version is not supported."""

    http = 505


class TargetTooLong(PayloadTooLarge):
    """The request line exceeds the limit."""

    http = 414
    default_remedy = "Use a shorter URL, or POST the envelope to /rcp/v1/messages."


class HeadTooLong(PayloadTooLarge):
    """Request line and headers together exceed the limit."""

    http = 431
    default_remedy = "Send fewer or shorter headers."


class UnknownMethod(NotImplementedByRobot):
    """No resource of the gateway supports the method."""

    default_remedy = f"Use one of {METHODS.decode()}."


class UnknownCoding(NotImplementedByRobot):
    """The transfer coding of the body is not supported."""

    default_remedy = "Send the body with Content-Length, or `Transfer-Encoding: chunked`."


def check_head(method: bytes, version: str, target: bytes, headers: Headers) -> tuple[bytes, int]:
    """Return the target's path and query, and the Content-Length; without one, 0.

    `Host` is replaced by that of an absolute target.

    :raises Malformed: the head is invalid or ambiguous.
    :raises UnknownMethod: the method is for proxies.
    :raises UnknownCoding: the body has a transfer coding other than chunked.
    """
    if version not in _VERSIONS:
        raise UnknownVersion(f"HTTP/{version} is not supported")
    if method == b"CONNECT":
        raise UnknownMethod("this gateway is not a proxy")
    host = coding = length = proof = None
    for name, value in headers:
        if name == b"host":
            if host is not None:
                raise Malformed("the request has more than one Host header")
            host = value
        elif name == b"authorization":
            if proof is not None:
                raise Malformed("the request has more than one Authorization header")
            proof = value
        elif name == b"transfer-encoding":
            coding = value if coding is None else coding + b"," + value
        elif name == b"content-length" and length is None:
            length = int(value)
    if coding is not None:
        _check_coding(coding, version, has_length=length is not None)
    _check_host(host, version)
    return _path(method, target, headers, host), length or 0


def _path(method: bytes, target: bytes, headers: Headers, host: bytes | None) -> bytes:
    if target.find(b"#") >= 0:
        raise Malformed("the request target has a fragment")
    if target.startswith(b"/"):
        return target
    if target == b"*" and method == b"OPTIONS":
        return target
    match = _ABSOLUTE.match(target)
    if match is None or match[1].lower() not in (b"http", b"https"):
        raise Malformed("the request target is neither a path nor an http URL")
    if not match[2] or not _AUTHORITY.match(match[2]):
        raise Malformed("the authority of the request target is not a host and port")
    # RFC 9112, 3.2.2: the host of an absolute target replaces the header, and is checked likewise.
    if host is not None:
        headers.remove((b"host", host))
    headers.append((b"host", match[2]))
    rest = match[3]
    return rest if rest[:1] == b"/" else b"/" + rest


def _check_host(host: bytes | None, version: str) -> None:
    if host is None:
        if version != "1.0":
            raise Malformed("the request has no Host header")
    elif not _AUTHORITY.match(host):
        raise Malformed("the Host header is not a host and port")


def _check_coding(coding: bytes, version: str, *, has_length: bool) -> None:
    """Refuse ambiguous body lengths (RFC 9112, 6.1 and 6.3)."""
    if has_length:
        raise Malformed("the request has both Content-Length and Transfer-Encoding")
    if version == "1.0":
        raise Malformed("Transfer-Encoding is not allowed in HTTP/1.0")
    if coding.strip().lower() != b"chunked":
        text = coding.decode("latin-1")[:80]
        raise UnknownCoding(f"the transfer coding {text!r} is not supported")
