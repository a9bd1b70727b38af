"""Verification of JSON Web Tokens by issuer and key (RFC 7519, RFC 8725).

An issuer's keys are fetched in the background; a token with an unknown key waits for the next
fetch.
Verified tokens are cached by hash, so that each signature is checked once; a cached token is valid
only as long as the key that signed it.
"""

from __future__ import annotations

import asyncio
import hashlib
import secrets
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from typing import Any

import structlog
from msgspec.structs import replace

from rcp_jwt.config import JwtConfig
from rcp_jwt.documents import Unreachable, fetch, read_document
from rcp_jwt.jwks import PublicKey, read_set, read_static
from rcp_jwt.kept_keys import KeptKeys
from rcp_jwt.login_config import LoginConfig
from rcp_jwt.provider import Provider, discover
from rcp_jwt.urls import shown_url
from rcp_jwt.verified import LoginProofs, Verified, VerifiedTokens
from rcp_jwt.webtokens import Read, check_id_token, needed_claims, principal_of, read_token, verify
from rcp_kernel.clock import Clock, iso
from rcp_kernel.contract.identity import Principal, fingerprint
from rcp_kernel.errors import AdapterUnavailable, ConfigError, RcpError, Unauthenticated
from rcp_protocol.timeouts import timeout

__all__ = ["Issuer", "Issuers", "source_of"]

log = structlog.get_logger("rcp.jwt")
_GAP = 3.0  # s between two fetches caused by tokens with unknown keys
_RETRY = (1.0, 30.0)  # s after a first failure, and the maximum
_WAIT = 9.0  # s that a login may wait: one gap and one fetch
_S = 1_000_000_000  # ns


class Issuer:
    """One `[[jwt]]` table and its keys."""

    def __init__(
        self, config: JwtConfig, clock: Clock, kept: KeptKeys, before: Issuer | None = None
    ) -> None:
        """Create the issuer; it takes over the keys of `before` if their source is the same.

        :raises ConfigError: a static key is invalid.
        """
        self.config = config
        self._now = clock.now
        self._kept = kept
        where = f"[[jwt]] '{config.issuer}'"
        self.keys: tuple[PublicKey, ...] = read_static(config.keys, where) if config.keys else ()
        self.facts: dict[str, Any] = {"name": f"jwt {shown_url(config.issuer)}", "state": "ready"}
        """For the health report."""
        self.provider: Provider | None = None
        """What its discovery document says; None before that was fetched, or if it is not to be."""
        self.fetched: float | None = None
        self.stale = False
        """Whether its keys could not be refreshed for their `lifetime`, so that none is valid."""
        self._lapse: asyncio.TimerHandle | None = None
        self._changed: Callable[[], None] = _nobody
        self._failures = 0
        self._began = -_GAP
        self._task: asyncio.Task[None] | None = None
        self._wanted = asyncio.Event()
        self._round: asyncio.Future[None] | None = None
        if before is not None and source_of(before.config) == source_of(config) and not config.keys:
            self.keys, self.fetched = before.keys, before.fetched
            self.provider = before.provider

    @property
    def fetches(self) -> bool:
        """Whether its keys are on a server."""
        return not self.config.keys

    def recall(self) -> None:
        """Take over the keys that were fetched in an earlier run, for the rest of their `lifetime`."""
        if not self.fetches or self.fetched is not None:
            return
        found = self._kept.recall(source_of(self.config), self.config.lifetime)
        if found is not None:
            self.keys = found.keys
            self.fetched = asyncio.get_running_loop().time() - found.age

    def start(self, changed: Callable[[], None]) -> None:
        """Fetch the keys periodically; `changed` is called when a key becomes invalid."""
        if self.fetches:
            self._changed = changed
            self._watch()
            self._round = asyncio.get_running_loop().create_future()
            self._task = asyncio.create_task(self._run(), name=self.facts["name"])

    def stop(self) -> None:
        """Stop fetching."""
        if self._lapse is not None:
            self._lapse.cancel()
            self._lapse = None
        if self._task is not None:
            self._task.cancel()
            self._task = None
        self._conclude()

    def candidates(self, read: Read) -> list[PublicKey]:
        """Return the keys that may have signed a token."""
        found = [key for key in self.keys if key.algorithm == read.algorithm]
        if read.key is None:
            return found
        named = [key for key in found if key.id == read.key]
        return named or [key for key in found if key.id is None]

    @property
    def reachable(self) -> bool:
        """Whether the last fetched keys are still valid."""
        return not self.fetches or (self.fetched is not None and not self.stale)

    def holds(self, thumbprint: str) -> bool:
        """Return whether a key is currently one of the issuer's."""
        return self.reachable and any(key.thumbprint == thumbprint for key in self.keys)

    def _watch(self) -> None:
        """Expire the keys at the end of their `lifetime`, unless they are refreshed before."""
        if self._lapse is not None:
            self._lapse.cancel()
        if self.fetched is None:
            return
        loop, end = asyncio.get_running_loop(), self.fetched + self.config.lifetime
        self.stale = end <= loop.time()
        self._lapse = None if self.stale else loop.call_at(end, self._lapsed)

    def _lapsed(self) -> None:
        self._lapse, self.stale = None, True
        log.error("jwt_keys_lapsed", issuer=shown_url(self.config.issuer), keys=len(self.keys))
        self.facts["detail"] = "its keys have not been fetched for too long, and count no more"
        self._changed()

    async def ask(self) -> None:
        """Request a fetch of the keys, and wait for it within a limit."""
        waited = self._round
        if waited is not None:
            self._wanted.set()
            await asyncio.wait((waited,), timeout=_WAIT)

    def _conclude(self) -> None:
        waited, self._round = self._round, None
        if waited is not None and not waited.done():
            waited.set_result(None)

    async def _run(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            self._began = loop.time()
            self._wanted.clear()
            self._take(await self._fetch())
            self._conclude()
            self._round = loop.create_future()
            with suppress(TimeoutError):
                async with timeout(self._pause()):
                    await self._wanted.wait()
            await asyncio.sleep(max(0.0, self._began + _GAP - loop.time()))

    def _pause(self) -> float:
        if not self._failures:
            return self.config.refresh
        return min(_RETRY[0] * 2 ** (self._failures - 1), _RETRY[1], self.config.refresh)

    async def _fetch(self) -> tuple[PublicKey, ...] | str:
        """Return the keys, or why they could not be fetched."""
        try:
            url = self.config.jwks_url or await self._discovered()
            try:
                return read_set(read_document(await fetch(url)))
            except ValueError as error:
                return f"the key set at {shown_url(url)} is not valid: {error}"
        except Unreachable as error:
            return str(error)

    async def _discovered(self) -> str:
        self.provider = await discover(self.config.issuer)
        return self.provider.jwks

    def _take(self, found: tuple[PublicKey, ...] | str) -> None:
        if isinstance(found, str):
            self._failures += 1
            if self._failures == 1:
                log.warning(
                    "jwt_keys_unreachable", issuer=shown_url(self.config.issuer), reason=found
                )
            self.facts |= {"state": "down", "detail": f"its keys cannot be fetched: {found}"}
            if self.fetched is not None and not self.stale:
                left = self.fetched + self.config.lifetime - asyncio.get_running_loop().time()
                until = iso(self._now() + int(left) * _S)
                self.facts["detail"] += f"; the last ones count until {until}"
            return
        if self._failures:
            log.info("jwt_keys_fetched", issuer=shown_url(self.config.issuer), keys=len(found))
        self._failures = 0
        self.fetched = asyncio.get_running_loop().time()
        self._watch()
        self.facts["state"] = "ready"
        self.facts.pop("detail", None)
        gone = {key.thumbprint for key in self.keys} - {key.thumbprint for key in found}
        self.keys = found
        self._kept.keep(source_of(self.config), found)
        if gone:
            self._changed()


def _nobody() -> None:
    """Do nothing: the default of `changed`."""


def source_of(config: JwtConfig) -> str:
    """Return what tells apart where keys come from, without secrets that an address may have."""
    source = (config.issuer, config.keys, config.jwks_url, config.discovery)
    return hashlib.sha256(repr(source).encode()).hexdigest()


class Issuers:
    """All issuers, and the cache of verified tokens."""

    def __init__(
        self,
        configs: Iterable[JwtConfig],
        tenants: Sequence[str],
        clock: Clock,
        before: Issuers | None = None,
        proofs: LoginProofs | None = None,
        kept: KeptKeys | None = None,
    ) -> None:
        """Create the issuers; the keys and cache of `before` are taken over.

        `proofs` are what people have logged in with, `kept` the keys of earlier runs.

        :raises ConfigError: a static key is invalid, or two tables have the same issuer.
        """
        old = {} if before is None else before.issuers
        keys = KeptKeys(clock, None) if kept is None else kept
        self.issuers: dict[str, Issuer] = {}
        for config in configs:
            if config.issuer in self.issuers:
                raise ConfigError(f"two [[jwt]] tables have the issuer '{config.issuer}'")
            self.issuers[config.issuer] = Issuer(config, clock, keys, old.get(config.issuer))
        self._tenants = tenants
        self._now = clock.now
        self._tables = object()
        self.verified = VerifiedTokens(clock) if before is None else before.verified
        """Tokens of programs."""
        self._proofs = LoginProofs(clock, None) if proofs is None else proofs

    def recall(self) -> None:
        """Take over the keys of an earlier run, for issuers that cannot be reached."""
        for issuer in self.issuers.values():
            issuer.recall()

    def start(self, changed: Callable[[], None]) -> None:
        """Start fetching; `changed` is called after a key was removed or has expired."""
        for issuer in self.issuers.values():
            issuer.start(changed)

    def stop(self) -> None:
        """Stop fetching."""
        for issuer in self.issuers.values():
            issuer.stop()

    def kept(self, digest: str) -> Principal | None:
        """Return the principal of a verified token, if its key is still valid."""
        found = self.verified.get(digest) or self._proofs.get(digest)
        if found is None:
            return None
        issuer = self.issuers.get(found.read.issuer)
        if issuer is not None and issuer.fetches and issuer.fetched is None:
            return None  # after a start: whether its key is still valid is not known yet
        if issuer is None or not issuer.holds(found.key):
            self._forget(digest)
            return None
        if found.tables is not self._tables:
            return self._reevaluate(digest, found, issuer.config)
        return found.principal

    def _forget(self, digest: str) -> None:
        self.verified.forget(digest)
        self._proofs.forget(digest)

    def _reevaluate(self, digest: str, found: Verified, config: JwtConfig) -> Principal | None:
        """Evaluate a verified token under changed tables: its signature remains valid."""
        if found.client is None:
            taken = (config.audience,) if isinstance(config.audience, str) else config.audience
        else:
            taken = () if config.login is None else (config.login.client_id,)
        named: Any = found.claims["aud"]
        meant = any(one in taken for one in ([named] if isinstance(named, str) else named))
        if meant and found.read.algorithm in config.algorithms:
            with suppress(RcpError):  # reported when the token is used again
                return self._keep(config, digest, found)
        self._forget(digest)
        return None

    def renewed(self, principal: Principal) -> Principal | None:
        """Return a principal with its current rights; None if it has none left."""
        return self.kept(principal.credential or "")

    def find(self, token: str, digest: str) -> Principal | Issuer:
        """Return the token's principal, or the issuer whose keys must be fetched first.

        :raises Unauthenticated: the token is invalid.
        :raises Forbidden: it is valid but grants no role here.
        """
        kept = self.kept(digest)
        if kept is not None:
            return kept
        read = read_token(token)
        issuer = self.issuers.get(read.issuer)
        if issuer is None:
            raise Unauthenticated("the token's issuer is not configured on this gateway")
        if read.algorithm not in issuer.config.algorithms:
            raise Unauthenticated("the token's signature algorithm is not accepted")
        keys = issuer.candidates(read) if issuer.reachable else []
        if not keys:
            if issuer.fetches:
                return issuer
            raise Unauthenticated("the token is signed with an unknown key")
        claims, key = verify(token, keys, issuer.config, issuer.config.audience)
        return self._keep(issuer.config, digest, Verified(claims, key.thumbprint, read))

    def verify_after_fetch(self, token: str, digest: str) -> Principal:
        """Verify a token as `find` after its issuer's keys were fetched.

        :raises AdapterUnavailable: they could not be fetched.
        """
        found = self.find(token, digest)
        if isinstance(found, Principal):
            return found
        if not found.reachable:
            raise _no_keys()
        raise Unauthenticated("the token is signed with a key that its issuer does not publish")

    async def log_in(self, issuer: Issuer, login: LoginConfig, token: str, nonce: str) -> Principal:
        """Return the principal of an ID token, for as long as a login of it lasts.

        Its `credential` is the hash of no token: nobody can show it instead of the login.

        :raises RcpError: as `find` and `verify_after_fetch`.
        """
        read = read_token(token)
        config = issuer.config
        if read.issuer != config.issuer:
            raise Unauthenticated("the ID token is of another issuer")
        if read.algorithm not in config.algorithms:
            raise Unauthenticated("the ID token's signature algorithm is not accepted")
        if not (issuer.reachable and issuer.candidates(read)):
            await issuer.ask()
        if not issuer.reachable:
            raise _no_keys()
        claims, key = verify(token, issuer.candidates(read), config, login.client_id)
        check_id_token(claims, login.client_id, nonce)
        # OpenID Connect Core, 3.1.3.7: `exp` is for the acceptance of the token, which is now.
        kept = needed_claims(config, claims) | {"exp": self._now() // _S + int(login.lifetime)}
        digest = fingerprint(secrets.token_urlsafe(32))
        found = Verified(kept, key.thumbprint, read, client=login.client_id)
        return self._keep(config, digest, found)

    def _keep(self, config: JwtConfig, digest: str, found: Verified) -> Principal:
        principal = principal_of(config, found.claims, digest, self._tenants, self._now())
        kept = self.verified if found.client is None else self._proofs
        kept.keep(digest, replace(found, principal=principal, tables=self._tables))
        return principal


def _no_keys() -> AdapterUnavailable:
    return AdapterUnavailable(
        "the keys of the token's issuer cannot be fetched at present",
        retry_after=_RETRY[0],
        remedy="Try again. If it persists, ask the operator to check the issuer.",
    )
