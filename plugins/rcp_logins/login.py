"""One login, as the store keeps it: the hash of its secret is its key there."""

from __future__ import annotations

import msgspec

from rcp_kernel.contract.identity import Grants, Principal

__all__ = ["Login"]


class Login(msgspec.Struct, kw_only=True):
    """A login. Times are ns since the UNIX epoch."""

    id: str
    digest: str
    """SHA-256 of the secret in the cookie."""
    name: str
    proof: str
    credential: str | None
    """Hash of the credential that it began with: without that, it ends."""
    grants: Grants
    via: str | None
    expires: int | None
    """When the credential ends."""
    address: str | None
    remembered: bool
    begun: int
    used: int

    @property
    def principal(self) -> Principal:
        """The principal that began it, as it was then."""
        return Principal(
            self.name, self.grants, self.proof, self.credential, self.expires, self.via
        )
