"""The key that signs cards: read once; its public half is served by the gateway."""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path
from typing import Any

import msgspec
from a2a.types.a2a_pb2 import AgentCard
from a2a.utils.signing import create_agent_card_signer
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, EllipticCurvePrivateKey
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from jwt.algorithms import ECAlgorithm, OKPAlgorithm, RSAAlgorithm

from rcp_kernel.errors import ConfigError

__all__ = ["CardKey"]

_REMEDY = "set [plugins.a2a] card_key to a P-256, RSA or Ed25519 private key as PEM, or to its file"
_NAMED = {"EC": ("crv", "kty", "x", "y"), "RSA": ("e", "kty", "n"), "OKP": ("crv", "kty", "x")}
"""The members of a key that its thumbprint covers: RFC 7638, 3.2."""


class CardKey:
    """A private key, with its algorithm and id."""

    def __init__(self, given: str) -> None:
        """Read a key from PEM, or from its file.

        :raises ConfigError: there is no key, or its type is not supported.
        """
        self._key, self.algorithm, made = _read(given)
        named = {name: made[name] for name in _NAMED[made["kty"]]}
        digest = hashlib.sha256(msgspec.json.encode(named, order="sorted")).digest()
        self.id = base64.urlsafe_b64encode(digest).rstrip(b"=").decode()
        self.jwks = {"keys": [{**made, "kid": self.id, "alg": self.algorithm, "use": "sig"}]}
        """The public key that verifies the signatures."""

    def sign(self, card: AgentCard, jwks: str) -> None:
        """Sign a card; `jwks` is the URL of the public key."""
        head: Any = {"kid": self.id, "alg": self.algorithm, "typ": "JOSE", "jku": jwks}
        create_agent_card_signer(self._key, head)(card)


def _read(given: str) -> tuple[Any, str, dict[str, Any]]:
    try:
        pem = given if "-----BEGIN" in given else Path(given).expanduser().read_text("utf-8")
        key = load_pem_private_key(pem.encode(), None)
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(f"the card key cannot be read ({error}): {_REMEDY}") from None
    if isinstance(key, EllipticCurvePrivateKey) and isinstance(key.curve, SECP256R1):
        return key, "ES256", ECAlgorithm.to_jwk(key.public_key(), as_dict=True)
    if isinstance(key, RSAPrivateKey):
        return key, "RS256", RSAAlgorithm.to_jwk(key.public_key(), as_dict=True)
    if isinstance(key, Ed25519PrivateKey):
        return key, "EdDSA", OKPAlgorithm.to_jwk(key.public_key(), as_dict=True)
    raise ConfigError(f"the card key has an unsupported type: {_REMEDY}")
