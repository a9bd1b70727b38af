"""Requests that stop or release something: they are neither counted nor refused."""

from __future__ import annotations

import msgspec

from rcp_kernel.errors import RcpError
from rcp_kernel.values import value_type
from rcp_kernel.wire import Request

__all__ = ["is_exempt"]

_ESTOP = "/system/estop"
_LEASES = "/system/leases"
_RELEASE = 2048  # bytes of a release at most


class _Asked(msgspec.Struct, frozen=True):
    """The part of a lease request that shows whether it is a release."""

    do: str


_ASKED = value_type(_Asked)


def is_exempt(request: Request) -> bool:
    """Return whether a request stops or releases something; such requests are never limited."""
    if request.type != "execute":
        return request.type == "cancel"
    return request.path == _ESTOP or (request.path == _LEASES and _releases(request))


def _releases(request: Request) -> bool:
    if len(bytes(request.body)) > _RELEASE:
        return False
    try:
        return request.decode_body(_ASKED, "release").do == "release"
    except RcpError:
        return False
