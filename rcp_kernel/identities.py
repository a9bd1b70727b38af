"""Who somebody is, by what they prove, and where they act, under the present configuration."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from rcp_kernel.certificates import Certificates
from rcp_kernel.config import GatewayConfig
from rcp_kernel.errors import Forbidden, Unauthenticated
from rcp_kernel.identity import Keyring, Principal, fingerprint
from rcp_kernel.peer import UNKNOWN, Peer, Serial

__all__ = ["Identities"]


class Identities:
    """Keys, certificates, and what a plugin knows of tokens."""

    def __init__(
        self, config: GatewayConfig, authenticator: Callable[[str], Principal | None] | None
    ) -> None:
        self._config = config
        self._authenticator = authenticator
        self._keyring = _keyring(config)
        self._certificates = Certificates(config.certificates)

    def configure(self, config: GatewayConfig) -> None:
        """Take over another configuration."""
        self._config = config
        self._keyring = _keyring(config)
        self._certificates = Certificates(config.certificates, self._certificates)

    def revoke(self, serials: frozenset[Serial]) -> bool:
        """Have client certificates count for nothing; tell whether they did until now."""
        if serials == self._certificates.revoked:
            return False
        self._certificates.revoked = serials
        return True

    def anonymous(self) -> Principal:
        """Return the principal of those who prove nothing.

        :raises Unauthenticated: the configuration gives them no role.
        """
        grants = self._config.anonymous.grants
        if not any(roles for _, roles in grants):
            raise Unauthenticated("this gateway serves nobody without a token")
        return Principal("anonymous", grants)

    def renewed(self, principal: Principal) -> Principal | None:
        """Return what a principal's proof is worth under the present configuration."""
        if principal.anonymous:
            with suppress(Unauthenticated):
                return self.anonymous()
            return None
        if principal.proof == "certificate":
            return self._certificates.renewed(principal)
        return self._keyring.renewed(principal) if principal.proof == "key" else principal

    @property
    def authenticates(self) -> bool:
        """Whether a plugin proves identities."""
        return self._authenticator is not None

    def authenticate(self, token: str | None, peer: Peer = UNKNOWN) -> Principal:
        """Return whom a bearer token proves, else the peer's certificate, else who is anonymous.

        A token never falls back on the certificate, and must not contradict it.

        :raises Unauthenticated: the token is not known, or the certificate is somebody else's.
        """
        certified = None
        if peer.certificate is not None:
            certified = self._certificates.find(peer.certificate)
        if token is None:
            return certified or self.anonymous()
        principal = self._by_token(token)
        if certified is not None and certified.name != principal.name:
            raise Unauthenticated(
                f"the token is that of '{principal.name}', the certificate that of "
                f"'{certified.name}'",
                remedy="Send the token of the certificate's owner, or none.",
            )
        return principal

    def _by_token(self, token: str) -> Principal:
        if self._authenticator is not None:
            principal = self._authenticator(token)
            if principal is not None:
                return principal
        return self._keyring.find(token)

    def tenants_of(self, principal: Principal) -> list[str]:
        """List the tenants that a principal acts in."""
        known = self._config.tenant_names
        return [t for t in known if "*" in principal.tenants or t in principal.tenants]

    def tenant_for(self, principal: Principal, wanted: str | None) -> str | None:
        """Return the tenant that relative paths mean.

        :raises Forbidden: the principal does not act in the wanted one.
        """
        tenants = self.tenants_of(principal)
        if wanted is None:
            return tenants[0] if tenants else None
        if wanted not in tenants:
            raise Forbidden(f"{principal.name} does not act in the tenant '{wanted[:64]}'")
        return wanted


def _keyring(config: GatewayConfig) -> Keyring:
    found: dict[str, Principal] = {}
    for key in config.keys:
        digest = key.sha256 or fingerprint(key.key or "")
        found[digest] = Principal(key.name, key.grants, "key", digest)
    return Keyring(found)
