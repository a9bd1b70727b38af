"""A hub's assertion of a person: a JSON Web Token, signed by the hub and valid for a minute.

`typ` is `rcp-hub+jwt`, so that no other token passes for one (RFC 8725, 3.11).
"""

from __future__ import annotations

import base64
import binascii
import secrets
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
from msgspec import Meta

from rcp_jwt.jwks import PublicKey
from rcp_jwt.webtokens import is_jwt
from rcp_kernel.errors import Unauthenticated

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

__all__ = ["LONGEST", "OWN_PROOF", "Assertion", "is_assertion", "sign", "verified"]

LONGEST = 60  # s from `iat` to `exp`
OWN_PROOF = "hub"
"""`rcp_proof` of a hub that speaks for itself."""
_TYPE = "rcp-hub+jwt"
_HEADER = 256  # characters
_Text = Annotated[str, Meta(min_length=1, max_length=128)]


class Assertion(msgspec.Struct, frozen=True, kw_only=True):
    """The claims; times in whole s since the UNIX epoch."""

    iss: _Text
    """The hub's id."""
    aud: _Text
    """`<tenant>/<gateway>` of the robot's gateway."""
    sub: _Text
    """The person's name."""
    rcp_proof: Annotated[str, Meta(min_length=1, max_length=512)]
    """How the hub knows the person: as `proof` of a principal, or `OWN_PROOF`."""
    rcp_roles: Annotated[tuple[_Text, ...], Meta(min_length=1, max_length=64)]
    iat: int
    exp: int
    jti: _Text

    @classmethod
    def of(
        cls, hub: str, audience: str, person: str, proof: str, roles: tuple[str, ...], moment: int
    ) -> Assertion:
        """Make an assertion at a moment, in ns since the UNIX epoch."""
        now = moment // 1_000_000_000
        return cls(
            iss=hub,
            aud=audience,
            sub=person,
            rcp_proof=proof,
            rcp_roles=roles,
            iat=now,
            exp=now + LONGEST,
            jti=secrets.token_urlsafe(16),
        )


def sign(assertion: Assertion, key: Ed25519PrivateKey) -> str:
    """Return the token of an assertion."""
    import jwt

    claims = msgspec.to_builtins(assertion)
    return jwt.encode(claims, key, "EdDSA", headers={"typ": _TYPE})


def is_assertion(token: str) -> bool:
    """Tell by a token's header whether it is meant as an assertion."""
    if not is_jwt(token):
        return False
    head = token.partition(".")[0]
    if len(head) > _HEADER:
        return False
    try:
        text = base64.urlsafe_b64decode(head + "=" * (-len(head) % 4))
        header: Any = msgspec.json.decode(text)
    except (msgspec.DecodeError, binascii.Error, ValueError):
        return False
    return isinstance(header, dict) and header.get("typ") == _TYPE  # pyright: ignore[reportUnknownMemberType]


def verified(token: str, keys: tuple[PublicKey, ...]) -> tuple[Assertion, PublicKey]:
    """Check a signature; return the claims, whose times are not checked, and the key.

    :raises Unauthenticated: no key has signed it, or its claims are not those of an assertion.
    """
    import jwt

    for key in keys:
        try:
            claims = jwt.decode(
                token,
                key.key,
                algorithms=["EdDSA"],
                options={
                    "verify_aud": False,
                    "verify_exp": False,
                    "verify_iat": False,
                    "verify_nbf": False,
                    "verify_sub": False,
                    "verify_jti": False,
                },
            )
        except jwt.InvalidSignatureError:
            continue
        except Exception:  # untrusted input: any error of the library means malformed
            break
        try:
            return msgspec.convert(claims, Assertion), key
        except msgspec.ValidationError as error:
            raise Unauthenticated(f"the assertion is not valid: {error}") from None
    raise Unauthenticated("the assertion is not signed with a key of its hub")
