"""Sealing of a file for one gateway: hubs and audit logs on the way cannot open it."""

from __future__ import annotations

import base64
import binascii
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

__all__ = ["SealError", "SealKey", "seal"]

_SIZE = 32  # bytes of a public key
_NONCE = bytes(12)  # each key encrypts one message


class SealError(ValueError):
    """What was received is not sealed, or to another key."""


class SealKey:
    """The key of one gateway, until it ends."""

    def __init__(self) -> None:
        from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

        self._private = X25519PrivateKey.generate()
        self._own = self._private.public_key().public_bytes_raw()
        self.public = base64.b64encode(self._own).decode()
        """What a sender needs."""

    def opened(self, sealed: str) -> bytes:
        """Return what was sealed.

        :raises SealError: it is not sealed to this key.
        """
        from cryptography.exceptions import InvalidTag
        from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PublicKey

        try:
            data = base64.b64decode(sealed, validate=True)
            theirs, secret = data[:_SIZE], data[_SIZE:]
            shared = self._private.exchange(X25519PublicKey.from_public_bytes(theirs))
            return _cipher(shared, theirs, self._own).decrypt(_NONCE, secret, None)
        except (binascii.Error, ValueError, InvalidTag):
            raise SealError("not sealed to this gateway's present key") from None


def seal(data: bytes, public: str) -> str:
    """Seal data so that only the gateway with this key can open it.

    :raises SealError: the key is not valid.
    """
    from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey

    own = X25519PrivateKey.generate()
    mine = own.public_key().public_bytes_raw()
    try:
        theirs = base64.b64decode(public, validate=True)
        shared = own.exchange(X25519PublicKey.from_public_bytes(theirs))
    except (binascii.Error, ValueError):
        raise SealError("the gateway's key is not a valid key") from None
    return base64.b64encode(
        mine + _cipher(shared, mine, theirs).encrypt(_NONCE, data, None)
    ).decode()


def _cipher(shared: bytes, sender: bytes, receiver: bytes) -> ChaCha20Poly1305:
    from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
    from cryptography.hazmat.primitives.hashes import SHA256
    from cryptography.hazmat.primitives.kdf.hkdf import HKDF

    info = b"rcp configuration" + sender + receiver
    return ChaCha20Poly1305(HKDF(SHA256(), _SIZE, None, info).derive(shared))
