"""The hub's end of assertions: its private key."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rcp_hubs.assertion import Assertion, sign
from rcp_kernel.clock import Clock
from rcp_kernel.errors import ConfigError
from rcp_store.modes import READ, WRITE, others_may

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

__all__ = ["HubSigner", "public_pem", "read_private_key"]


class HubSigner:
    """Signs what a hub asserts."""

    def __init__(self, hub: str, key: Ed25519PrivateKey, clock: Clock) -> None:
        self.hub = hub
        self._key, self._clock = key, clock

    def token(self, audience: str, person: str, proof: str, roles: tuple[str, ...]) -> str:
        """Return a new assertion of a person to a robot's gateway, good for one `hello`."""
        moment = self._clock.now()
        return sign(Assertion.of(self.hub, audience, person, proof, roles, moment), self._key)


def read_private_key(file: str, where: str) -> Ed25519PrivateKey:
    """Read a private key that only its owner may read.

    :raises ConfigError: it is not there, not an Ed25519 key, or others may read or write it.
    """
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    path = Path(file).expanduser()
    try:
        text = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{where} '{file}' cannot be read: {error.strerror}") from None
    if others_may(path, READ | WRITE):
        raise ConfigError(
            f"{where} '{file}': other users can read or write it: run `chmod 600 {file}`"
        )
    try:
        key = load_pem_private_key(text, None)
    except (ValueError, TypeError):
        key = None
    if not isinstance(key, Ed25519PrivateKey):
        raise ConfigError(f"{where} '{file}' is not an Ed25519 private key in PEM, unencrypted")
    return key


def public_pem(key: Ed25519PrivateKey) -> str:
    """Return the public part of a key."""
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

    public = key.public_key()
    return public.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo).decode()
