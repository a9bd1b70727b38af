"""Keys of hubs, and the assertions that they sign."""

from __future__ import annotations

import time
from typing import Any

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
)

from rcp_hubs.assertion import Assertion, sign


class HubKey:
    """A hub's id with its private key."""

    def __init__(self, hub: str = "h1") -> None:
        self.hub = hub
        self.private = Ed25519PrivateKey.generate()
        public = self.private.public_key()
        self.pem = public.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo).decode()

    @property
    def private_pem(self) -> str:
        """The secret, as a hub keeps it in a file."""
        form = PrivateFormat.PKCS8
        return self.private.private_bytes(Encoding.PEM, form, NoEncryption()).decode()

    def table(self, roles: str = '["operator"]', more: str = "") -> str:
        """Write the table of a robot's gateway for this hub."""
        return (
            f'[[hubs]]\nid = "{self.hub}"\nroles = {roles}\n'
            f'public_key = """\n{self.pem}"""\n{more}\n'
        )

    def assertion(self, moment: int | None = None, /, **claims: Any) -> str:
        """Sign an assertion of ann, the operator, to gateway r7 of tenant alpha."""
        made = Assertion.of(
            self.hub, "alpha/r7", "ann", "key", ("operator",), moment or time.time_ns()
        )
        return sign(msgspec.structs.replace(made, **claims), self.private)
