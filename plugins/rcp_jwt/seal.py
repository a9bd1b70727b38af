"""A login under way, in a cookie that only this gateway can read and make."""

from __future__ import annotations

import base64
import secrets
from typing import Any

import msgspec

__all__ = ["Pending", "Seal"]

_NONCE = 12  # bytes: AES-GCM, NIST SP 800-38D
_PURPOSE = b"rcp-gateway login at an issuer"


class Pending(msgspec.Struct, frozen=True, array_like=True):
    """A login under way."""

    id: str
    """Where."""
    began: int
    """ns since the UNIX epoch."""
    state: str
    nonce: str
    verifier: str
    """Of PKCE (RFC 7636)."""
    next: str
    remember: bool
    former: str | None


class Seal:
    """Encrypts and authenticates with a key of this run: what another run sealed is not known."""

    def __init__(self) -> None:
        self._key = secrets.token_bytes(32)

    def close(self, pending: Pending) -> str:
        """Return a text for a cookie."""
        nonce = secrets.token_bytes(_NONCE)
        sealed = self._cipher().encrypt(nonce, msgspec.msgpack.encode(pending), _PURPOSE)
        return base64.urlsafe_b64encode(nonce + sealed).decode()

    def open(self, text: str) -> Pending | None:
        """Return what was sealed; None if it was not here."""
        from cryptography.exceptions import InvalidTag

        try:
            data = base64.b64decode(text.encode(), b"-_", validate=True)
            plain = self._cipher().decrypt(data[:_NONCE], data[_NONCE:], _PURPOSE)
        except (ValueError, InvalidTag):
            return None
        return msgspec.msgpack.decode(plain, type=Pending)

    def _cipher(self) -> Any:
        from cryptography.hazmat.primitives.ciphers.aead import AESGCM

        return AESGCM(self._key)
