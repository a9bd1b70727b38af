"""Authentication: from a token or a certificate to a principal, and for how long it is valid.

Cached results are returned immediately (`known`); a token whose issuer's keys must be fetched can
be awaited (`wait`). Secrets are neither stored nor shown: only their hashes are used further.
"""

from __future__ import annotations

import asyncio
import math
import os
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import structlog

from rcp_kernel.access.auth_throttle import AuthThrottle
from rcp_kernel.access.authenticator import Authenticator, TokenIssuer
from rcp_kernel.access.certificates import Certificates
from rcp_kernel.clock import SYSTEM_CLOCK, Clock
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.identity import instant
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.identity import Keyring, Principal, check_time, fingerprint
from rcp_kernel.contract.peer import UNKNOWN, Peer, Serial
from rcp_kernel.errors import (
    ConfigError,
    Forbidden,
    InternalError,
    PluginError,
    RateLimited,
    RcpError,
    TokenExpired,
    Unauthenticated,
)

__all__ = ["Identities", "check_proofs", "store_file"]

log = structlog.get_logger("rcp.identity")
_OWN = ("none", "key", "certificate")
"""Proofs of the gateway itself."""
_LOGINS = "logins"
"""The authenticator that keeps logins, each for the principal of another proof."""
_P = ParamSpec("_P")
_T = TypeVar("_T")


def store_file(config: GatewayConfig) -> Path | None:
    """Return the path of the store; None without one."""
    given = config.store.path
    return None if given is None else Path(os.path.expanduser(given))  # noqa: PTH111 - no I/O


def check_proofs(config: GatewayConfig, source: str) -> None:
    """Find the faults of certificates that only show when they are read.

    :raises ConfigError: there is one.
    """
    try:
        Certificates(config.certificates, SYSTEM_CLOCK)
    except ConfigError as error:
        raise ConfigError(f"{source}: {error}") from None


class Identities:
    """Authenticates clients. For the event loop's thread."""

    def __init__(
        self,
        settings: Settings,
        loop: asyncio.AbstractEventLoop,
        clock: Clock,
    ) -> None:
        self._clock = clock
        self._settings = settings
        self._loop = loop
        self._authenticators: dict[str, Authenticator] = {}
        self.on_change: list[Callable[[], None]] = []
        """Called when the rights or validity of principals may have changed."""
        config = settings.config
        self._certificates = Certificates(config.certificates, clock)
        self._keyring = _keyring(config)
        self._anonymous = _anonymous(config)
        self._token_throttle = AuthThrottle(config.limits.failed_logins, self._loop.time)
        self._login_throttle = AuthThrottle(config.limits.failed_logins, self._loop.time)
        """Attempts with a third party, which wrong keys from the same address do not block."""

    def set_authenticators(self, authenticators: Iterable[Authenticator]) -> None:
        """Set the authenticators, called by name after the gateway's own keys.

        :raises PluginError: two authenticators have the same name, or one has a reserved name.
        """
        for one in sorted(authenticators, key=lambda each: each.name):
            own = _OWN if one.local else (*_OWN, "token")
            if one.name in self._authenticators or one.name in own:
                raise PluginError(f"the name '{one.name}' of an authenticator is taken")
            self._authenticators[one.name] = one
            one.on_change.append(self._review)

    def _review(self) -> None:
        for changed in self.on_change:
            changed()

    def reconfigure(self, config: GatewayConfig) -> None:
        """Apply the credentials of another configuration; the caller reviews the sessions."""
        self._certificates = Certificates(config.certificates, self._clock, self._certificates)
        self._keyring = _keyring(config)
        self._anonymous = _anonymous(config)
        self._token_throttle.allowance = self._login_throttle.allowance = (
            config.limits.failed_logins
        )

    def revoke(self, serials: frozenset[Serial]) -> None:
        """Revoke client certificates, in open sessions too."""
        if serials != self._certificates.revoked:
            self._certificates.revoked = serials
            self._review()

    @property
    def serves(self) -> bool:
        """Whether an authenticator outside the kernel's configuration can prove a principal."""
        return any(one.serves for one in self._authenticators.values())

    @property
    def issuers(self) -> list[TokenIssuer]:
        """The issuers of the tokens that this gateway accepts."""
        return [issuer for one in self._authenticators.values() for issuer in one.issuers]

    @property
    def facts(self) -> list[dict[str, Any]]:
        """The status of the authenticators, for the health report."""
        return [facts for one in self._authenticators.values() for facts in one.facts]

    # -- who -----------------------------------------------------------------------------------

    def anonymous(self) -> Principal:
        """Return the principal of clients that prove nothing.

        :raises Unauthenticated: the configuration gives them no role.
        """
        if self._anonymous is None:
            raise Unauthenticated("authentication required")
        return self._anonymous

    def longest(self, principal: Principal) -> int:
        """Return the length of the longest message that a principal may send."""
        config = self._settings.config
        if principal.anonymous and not config.acts(principal.roles):
            return min(config.limits.unproved, config.limits.message)
        return config.limits.message

    def tenants_of(self, principal: Principal) -> list[str]:
        """List the tenants that a principal acts in."""
        known = self._settings.config.tenant_names
        return [t for t in known if "*" in principal.tenants or t in principal.tenants]

    def tenant_for(self, principal: Principal, wanted: str | None) -> str | None:
        """Return the tenant that relative paths mean.

        :raises Forbidden: the principal does not act in the wanted one.
        """
        tenants = self.tenants_of(principal)
        if wanted is None:
            return tenants[0] if tenants else None
        if wanted not in tenants:
            raise Forbidden(f"{principal.name} has no access to the tenant '{wanted[:64]}'")
        return wanted

    def renewed(self, principal: Principal) -> Principal | None:
        """Return the principal with its current rights; None if its credentials are invalid."""
        if principal.expires is not None and principal.expires <= self._clock.now():
            return None
        if principal.login is not None:
            logins = self._authenticators.get(_LOGINS)
            return None if logins is None else logins.renewed(principal)
        if principal.anonymous:
            with suppress(Unauthenticated):
                return self.anonymous()
            return None
        if principal.proof == "certificate":
            return self._certificates.renewed(principal)
        if principal.proof == "key":
            return self._keyring.proves(principal.credential or "")
        authenticator = self._authenticators.get(principal.proof.partition(" ")[0])
        return None if authenticator is None else authenticator.renewed(principal)

    def known(
        self, token: str | None, peer: Peer = UNKNOWN, *, fetched: bool = False
    ) -> Principal | None:
        """Return the principal of a token, else of the peer's certificate, else anonymous.

        None means that a fetch is required, unless it is already `fetched`. A token never falls back
        on the certificate, and must not contradict it.

        :raises Unauthenticated: the token is unknown, or the certificate is another principal's.
        :raises TokenExpired: the token has expired.
        :raises RateLimited: the peer has sent too many invalid tokens.
        """
        certified = None
        if peer.certificate is not None:
            certified = self._certificates.find(peer.certificate)
        if token is None:
            return certified or self.anonymous()
        digest = fingerprint(token)
        try:
            # By the hash alone, at no cost: a valid token is never delayed by those who guess.
            principal = self._proved(digest) or self._verified(token, digest, peer, fetched=fetched)
            if principal is None:
                return None
            _agree(certified, check_time(principal, self._clock.now()))
        except TokenExpired:  # it was valid once, so it was not guessed
            raise
        except Unauthenticated:
            self._token_throttle.failed(peer.address, digest)
            raise
        self._token_throttle.succeeded(digest)
        return principal

    async def wait(self, token: str, peer: Peer = UNKNOWN) -> Principal:
        """Return the principal of a token for which `known` requires a fetch.

        :raises AdapterUnavailable: the fetch failed.
        :raises RcpError: as for `known`.
        """
        authenticator = self._authenticator_of(token)
        if authenticator is not None:
            await self._fetch(authenticator, token)
        found = self.known(token, peer, fetched=True)
        assert found is not None
        return found

    @contextmanager
    def attempt(self, peer: Peer) -> Generator[None]:
        """Let a peer try to authenticate with a third party.

        It counts as failed while it lasts, so that many at once get no further than one by one,
        and for good if it ends with `Unauthenticated`.

        :raises RateLimited: it has failed too often.
        """
        try:
            self._login_throttle.check(peer.address, "")
        except RateLimited as error:
            wait = error.retry_after or 1.0
            raise RateLimited(
                "too many logins from this address have failed or are under way",
                retry_after=error.retry_after,
                remedy=f"Wait {math.ceil(wait)} s, then log in again.",
            ) from None
        self._login_throttle.failed(peer.address, "")
        try:
            yield
        except Unauthenticated:
            raise
        except BaseException:
            self._login_throttle.forgive(peer.address)
            raise
        self._login_throttle.forgive(peer.address)

    def _proved(self, digest: str) -> Principal | None:
        found = self._keyring.proves(digest)
        if found is None:
            for authenticator in self._authenticators.values():
                found = authenticator.proves(digest)
                if found is not None:
                    break
        return found

    def _verified(self, token: str, digest: str, peer: Peer, *, fetched: bool) -> Principal | None:
        authenticator = self._authenticator_of(token)
        if not fetched:
            signed = authenticator is not None and authenticator.signed
            self._token_throttle.check(peer.address, digest, signed=signed)
        if authenticator is None:
            raise Unauthenticated("unknown token")
        principal = _contained(authenticator.verify, token, digest, fetched=fetched)
        if principal is None and fetched:
            raise Unauthenticated("unknown token")
        if principal is not None and principal.proof.partition(" ")[0] != authenticator.name:
            log.error("authenticator_failed", name=authenticator.name, error="proof of another")
            raise InternalError("the token could not be verified")
        return principal

    def _authenticator_of(self, token: str) -> Authenticator | None:
        for authenticator in self._authenticators.values():
            if _contained(authenticator.recognises, token):
                return authenticator
        return None

    async def _fetch(self, authenticator: Authenticator, token: str) -> None:
        try:
            await authenticator.fetch(token, fingerprint(token))
        except RcpError:
            pass  # `verify` reports it
        except Exception as error:
            _log_failure(error)


def _contained(call: Callable[_P, _T], *args: _P.args, **named: _P.kwargs) -> _T:
    """Call a feature with a token; report only kind and place of its errors.

    Their text may contain the token.
    """
    try:
        return call(*args, **named)
    except RcpError:
        raise
    except Exception as error:
        _log_failure(error)
    raise InternalError("the token could not be verified")


def _log_failure(error: Exception) -> None:
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    log.error(
        "authenticator_failed",
        error=type(error).__name__,
        file=None if place is None else place.tb_frame.f_code.co_filename,
        line=None if place is None else place.tb_lineno,
    )


def _agree(certified: Principal | None, principal: Principal) -> None:
    if certified is not None and certified.name != principal.name:
        raise Unauthenticated(
            f"the token belongs to '{principal.name}', the certificate to '{certified.name}'",
            remedy="Send the token of the certificate's owner, or no token.",
        )


def _anonymous(config: GatewayConfig) -> Principal | None:
    """Return the principal of those who prove nothing, or None if they have no role."""
    grants = config.anonymous.grants
    return Principal("anonymous", grants) if any(roles for _, roles in grants) else None


def _keyring(config: GatewayConfig) -> Keyring:
    found: dict[str, Principal] = {}
    for key in config.keys:
        digest = key.sha256 or fingerprint(key.key or "")
        expires = None if key.expires is None else instant(key.expires)
        found[digest] = Principal(key.name, key.grants, "key", digest, expires)
    return Keyring(found)
