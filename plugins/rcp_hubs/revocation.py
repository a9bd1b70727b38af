"""The list of revoked hub keys: signed with the key of the fleet, with a number that only grows."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

import msgspec
from msgspec import Meta

from rcp_jwt.jwks import PublicKey, read_static
from rcp_kernel.errors import ConfigError, Unauthenticated
from rcp_kernel.features import ServiceKey

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

__all__ = ["NONE", "REVOCATIONS", "RevocationList", "fleet_key", "read_list", "sign_list"]

REVOCATIONS: ServiceKey[Callable[[bytes], None]] = ServiceKey("hubs.revocations")
"""Takes a list as received."""
_TYPE = "rcp-revoked+jwt"
_LONGEST = 1_048_576  # bytes


class RevocationList(msgspec.Struct, frozen=True, kw_only=True):
    """What the fleet does not trust any more."""

    number: Annotated[int, Meta(ge=0)]
    keys: tuple[str, ...] = ()
    """SHA-256 of each public key in DER form."""


NONE = RevocationList(number=0)


def sign_list(found: RevocationList, key: Ed25519PrivateKey) -> str:
    """Return a list as it is published."""
    import jwt

    return jwt.encode(msgspec.to_builtins(found), key, "EdDSA", headers={"typ": _TYPE})


def read_list(data: bytes, key: PublicKey) -> RevocationList:
    """Read a list.

    :raises Unauthenticated: the key of the fleet has not signed it, or it is no list.
    """
    import jwt

    try:
        if len(data) > _LONGEST:
            raise ValueError
        whole = jwt.decode_complete(
            data, key.key, algorithms=["EdDSA"], options={"verify_signature": True}
        )
        if whole["header"].get("typ") != _TYPE:
            raise ValueError
        return msgspec.convert(whole["payload"], RevocationList)
    except Exception:  # untrusted input: any error of the library means malformed
        raise Unauthenticated("the list of revoked hubs is not signed by the fleet") from None


def fleet_key(given: str) -> PublicKey:
    """Read the public key of the fleet.

    :raises ConfigError: it is no Ed25519 public key.
    """
    keys = read_static(given, "[transports.zenoh]", "fleet_key")
    if len(keys) != 1 or keys[0].algorithm != "EdDSA":
        raise ConfigError("[transports.zenoh]: `fleet_key` must be an Ed25519 public key")
    return keys[0]
