"""One JSON Web Token: parsing, verification and the resulting principal."""

from __future__ import annotations

import base64
import hmac
import json
import re
from collections.abc import Sequence
from typing import Any

import msgspec

from rcp_jwt.config import JwtConfig
from rcp_jwt.jwks import PublicKey
from rcp_kernel.contract.identity import Grants, Principal, check_time
from rcp_kernel.errors import Forbidden, TokenExpired, Unauthenticated
from rcp_protocol.plain import is_list, is_map

__all__ = [
    "Claims",
    "Read",
    "check_id_token",
    "is_jwt",
    "needed_claims",
    "principal_of",
    "read_token",
    "verify",
]

Claims = dict[str, Any]
_LONGEST = 16_384  # characters
_NAME = 128  # characters
_FORM = re.compile(r"[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+\Z")  # RFC 7515, 2: no padding
_TRIED = 8  # keys tried for a token that names none
_S = 1_000_000_000  # ns
_LAST = 253_402_300_799  # s: the end of the year 9999


class Read(msgspec.Struct, frozen=True):
    """The unverified contents of a token."""

    issuer: str
    algorithm: str
    key: str | None


def is_jwt(token: str) -> bool:
    """Return whether a token has the form of a JWT."""
    return token.startswith("eyJ") and token.count(".") == 2


def read_token(token: str) -> Read:
    """Parse the header and issuer of a token.

    :raises Unauthenticated: it is malformed, or uses unsupported extensions.
    """
    import jwt

    if len(token) > _LONGEST:
        raise Unauthenticated(f"the token is longer than {_LONGEST} characters")
    if not _FORM.match(token):
        raise _malformed()
    try:
        head: Any = jwt.get_unverified_header(token)
        claims: Any = jwt.decode(token, options={"verify_signature": False})
        _check_names(token)
    except Exception:  # untrusted input: any error of the library means malformed
        raise _malformed() from None
    issuer, algorithm, key = claims.get("iss"), head.get("alg"), head.get("kid")
    if not isinstance(issuer, str) or not isinstance(algorithm, str):
        raise _malformed()
    if "crit" in head:  # RFC 7515, 4.1.11: unknown extensions must be refused
        raise Unauthenticated("the token has critical extensions (`crit`), which are not supported")
    return Read(issuer, algorithm, key if isinstance(key, str) else None)


def _check_names(token: str) -> None:
    """Refuse duplicate names, which parsers treat differently (RFC 7515, 4; RFC 7519, 4)."""
    for part in token.split(".")[:2]:
        text = base64.urlsafe_b64decode(part + "=" * (-len(part) % 4))
        json.loads(text, object_pairs_hook=_unique)


def _unique(pairs: list[tuple[str, Any]]) -> Claims:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a name occurs twice")
    return found


def _malformed() -> Unauthenticated:
    return Unauthenticated("the token is malformed")


def verify(
    token: str, keys: list[PublicKey], config: JwtConfig, audience: str | Sequence[str]
) -> tuple[Claims, PublicKey]:
    """Verify signature and claims; return the claims and the key that signed.

    :raises TokenExpired: the token has expired.
    :raises Unauthenticated: the token is invalid.
    """
    import jwt

    for key in keys[:_TRIED]:
        try:
            claims = jwt.decode(
                token,
                key.key,
                algorithms=[key.algorithm],
                audience=[audience] if isinstance(audience, str) else list(audience),
                issuer=config.issuer,
                leeway=config.leeway,
                options={"require": ["exp", "iss", "aud"]},
            )
        except jwt.InvalidSignatureError:
            continue
        except jwt.ExpiredSignatureError:
            raise TokenExpired("the token has expired") from None
        except jwt.ImmatureSignatureError:
            raise Unauthenticated(
                "the token is not valid yet: its `nbf` or `iat` is in the future",
                remedy="Check that the clocks of the issuer and the gateway agree.",
            ) from None
        except jwt.InvalidAudienceError:
            raise Unauthenticated("the token is for another audience (`aud`)") from None
        except jwt.MissingRequiredClaimError:
            raise Unauthenticated("the token needs the claims `exp`, `iss` and `aud`") from None
        except Exception:  # as in `read_token`
            raise _malformed() from None
        return claims, key
    raise Unauthenticated("the token's signature is invalid")


def check_id_token(claims: Claims, client: str, nonce: str) -> None:
    """Check what an ID token has beyond other tokens (OpenID Connect Core, 3.1.3.7).

    :raises Unauthenticated: it was not issued for this login.
    """
    audience, party = claims["aud"], claims.get("azp")
    if party != client and (party is not None or (is_list(audience) and len(audience) > 1)):
        raise Unauthenticated("the ID token was given to another client (`azp`)")
    found: Any = claims.get("nonce")
    if not isinstance(found, str) or not hmac.compare_digest(found.encode(), nonce.encode()):
        raise Unauthenticated("the ID token is not for this login: its `nonce` is another")


def needed_claims(config: JwtConfig, claims: Claims) -> Claims:
    """Return the claims that decide on a principal, and none of the others that a person has."""
    names = {"aud", "exp", "iat"}
    for name in (config.name_claim, config.role_claim, config.tenant_claim):
        if name is not None:
            names |= {name, name.partition(".")[0]}
    return {name: value for name, value in claims.items() if name in names}


def principal_of(
    config: JwtConfig, claims: Claims, digest: str, tenants: Sequence[str], moment: int
) -> Principal:
    """Return the principal of a verified token.

    :raises TokenExpired: it is older than `max_age`.
    :raises Unauthenticated: a required claim is missing.
    :raises Forbidden: its claims grant no role.
    """
    name = _claim(claims, config.name_claim)
    if not isinstance(name, str) or not 0 < len(name) <= _NAME or not name.isprintable():
        raise Unauthenticated(f"the token's claim `{config.name_claim}` is not a valid name")
    end = min(int(claims["exp"]), _LAST)
    if config.max_age is not None:
        begun: Any = claims.get("iat")
        if not isinstance(begun, (int, float)):
            raise Unauthenticated("the token needs the claim `iat`")
        end = min(end, begun + config.max_age)
    grants = _grants(config, claims, tenants)
    if not any(roles for _, roles in grants):
        raise Forbidden(
            f"the token gives {config.prefix}{name} no role on this gateway",
            remedy="Ask the operator which claims assign a role.",
        )
    expires = int((end + config.leeway) * _S)
    made = Principal(config.prefix + name, grants, f"jwt {config.issuer}", digest, expires)
    return check_time(made, moment)


def _claim(claims: Claims, name: str) -> Any:
    """Return a claim by name; dots select nested fields."""
    if name in claims:
        return claims[name]
    found: Any = claims
    for step in name.split("."):
        if not is_map(found):
            return None
        found = found.get(step)
    return found


def _texts(value: Any) -> list[str]:
    return [one for one in (value if is_list(value) else [value]) if isinstance(one, str)]


def _grants(config: JwtConfig, claims: Claims, tenants: Sequence[str]) -> Grants:
    given = [config.grants]
    if config.role_claim is not None:
        held = _texts(_claim(claims, config.role_claim))
        given += [config.by_claim[value].grants for value in held if value in config.by_claim]
    only: list[str] | None = None
    if config.tenant_claim is not None:
        # `*` in a claim is no tenant name, so it cannot grant access to all tenants.
        only = [t for t in _texts(_claim(claims, config.tenant_claim)) if t in tenants]
    found: dict[str, dict[str, None]] = {}
    for tenant, roles in (pair for grants in given for pair in grants):
        places = [tenant] if only is None else [t for t in only if tenant in ("*", t)]
        for place in places:
            found.setdefault(place, {}).update(dict.fromkeys(roles))
    return tuple((tenant, tuple(roles)) for tenant, roles in found.items())
