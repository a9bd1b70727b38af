"""Public keys of token issuers, from text and files; each key is used with only one algorithm."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from rcp_jwt.documents import read_document
from rcp_kernel.errors import ConfigError
from rcp_protocol.plain import is_list, is_map

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.types import PublicKeyTypes

__all__ = ["PublicKey", "der_of", "read_der", "read_set", "read_static"]

_MOST = 64  # keys of one issuer
_RSA_BITS = 2048  # RFC 8725, 3.5


class PublicKey(msgspec.Struct, frozen=True):
    """A key for signature verification."""

    id: str | None
    algorithm: str
    """The only algorithm it is used with."""
    key: Any
    """A key object of `cryptography`."""
    thumbprint: str
    """SHA-256 of its DER form."""


def read_set(document: Any) -> tuple[PublicKey, ...]:
    """Parse a JWKS or a single JWK; unsuitable keys are skipped.

    :raises ValueError: there is no suitable key.
    """
    if not is_map(document):
        raise ValueError("it is not a JSON object")
    listed: Any = document.get("keys", [document])
    if not is_list(listed):
        raise ValueError("`keys` is not a list")
    found = tuple(key for one in listed[:_MOST] if (key := _read_jwk(one)) is not None)
    if not found:
        raise ValueError(
            "it has no signing key of a supported type (RSA with 2048 bits or more, P-256, Ed25519)"
        )
    return found


def _read_jwk(jwk: Any) -> PublicKey | None:
    from jwt import PyJWTError
    from jwt.algorithms import ECAlgorithm, OKPAlgorithm, RSAAlgorithm

    if not is_map(jwk) or jwk.get("use", "sig") != "sig":
        return None
    public = {k: v for k, v in jwk.items() if k in ("kty", "crv", "n", "e", "x", "y")}
    reader = {"RSA": RSAAlgorithm, "EC": ECAlgorithm, "OKP": OKPAlgorithm}.get(str(jwk.get("kty")))
    if reader is None:
        return None
    try:
        key: Any = reader.from_jwk(public)
    except (PyJWTError, ValueError, TypeError, KeyError, OverflowError):
        return None
    kid: Any = jwk.get("kid")
    made = _made(key, kid if isinstance(kid, str) else None)
    return made if made is not None and jwk.get("alg", made.algorithm) == made.algorithm else None


def _made(key: PublicKeyTypes, kid: str | None) -> PublicKey | None:
    from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, EllipticCurvePublicKey
    from cryptography.hazmat.primitives.asymmetric.ed448 import Ed448PublicKey
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.asymmetric.rsa import RSAPublicKey
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

    if isinstance(key, RSAPublicKey) and key.key_size >= _RSA_BITS:
        algorithm = "RS256"
    elif isinstance(key, EllipticCurvePublicKey) and isinstance(key.curve, SECP256R1):
        algorithm = "ES256"
    elif isinstance(key, (Ed25519PublicKey, Ed448PublicKey)):
        algorithm = "EdDSA"
    else:
        return None
    der = key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    return PublicKey(kid, algorithm, key, hashlib.sha256(der).hexdigest())


def der_of(key: PublicKey) -> bytes:
    """Return a key in the form that `read_der` takes."""
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

    return key.key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)


def read_der(kid: str | None, der: bytes) -> PublicKey:
    """Return a key from its DER form.

    :raises ValueError: it is none that this gateway supports.
    """
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.serialization import load_der_public_key

    try:
        made = _made(load_der_public_key(der), kid)
    except UnsupportedAlgorithm as error:
        raise ValueError(str(error)) from None
    if made is None:
        raise ValueError("the key type is not supported")
    return made


def read_static(
    given: str | Iterable[str], where: str, option: str = "keys"
) -> tuple[PublicKey, ...]:
    """Parse the keys of an option of the configuration: PEM, JWK or JWKS, as text or file paths.

    :raises ConfigError: one of them is invalid; its text is not shown.
    """
    found: list[PublicKey] = []
    for number, text in enumerate((given,) if isinstance(given, str) else given, 1):
        place = f"{where}: `{option}` number {number}"
        if not text.lstrip().startswith(("-----BEGIN", "{")):
            place = f"{where}: `{option}` '{text[:200]}'"
            try:
                text = Path(text).expanduser().read_text(encoding="utf-8")  # noqa: PLW2901
            except (OSError, ValueError) as error:
                reason = getattr(error, "strerror", None) or "not a path or not text"
                raise ConfigError(f"{place} cannot be read: {reason}") from None
        try:
            found += _read_text(text)
        except ValueError as error:
            raise ConfigError(f"{place} is not a public key: {error}") from None
    return tuple(found)


def _read_text(text: str) -> tuple[PublicKey, ...]:
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.serialization import load_pem_public_key

    if text.lstrip().startswith("{"):
        return read_set(read_document(text.encode()))
    if "PRIVATE KEY" in text:
        raise ValueError("it is a private key; only the issuer may have it")
    begin = "-----BEGIN PUBLIC KEY-----"
    found: list[PublicKey] = []
    for block in text.split(begin)[1:]:
        try:
            made = _made(load_pem_public_key((begin + block).encode()), None)
        except (ValueError, UnsupportedAlgorithm):
            raise ValueError("a PEM block cannot be read") from None
        if made is None:
            raise ValueError(
                "the key type is not supported: use RSA (2048 bits or more), P-256 or Ed25519"
            )
        found.append(made)
    if not found:
        raise ValueError("write PEM (BEGIN PUBLIC KEY), JWK or JWKS")
    return tuple(found)
