"""The logins of a gateway: from the secret in a cookie to the principal that began the login."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

import msgspec
import structlog

from rcp_kernel.access.authenticator import Authenticator
from rcp_kernel.contract.identity import Principal, fingerprint, same_rights
from rcp_kernel.errors import Forbidden, QueueFull, Unauthenticated
from rcp_kernel.features import FeatureHost
from rcp_logins.config import LoginsConfig
from rcp_logins.login import Login
from rcp_web.logins import NewLogin
from rcp_web.oidc import OIDC

__all__ = ["PATH", "LoginAuthenticator"]

log = structlog.get_logger("rcp.identity")
PATH = "/system/logins"
_PREFIX = "rcplogin_"
_S = 1_000_000_000  # ns
_NOTED = 60 * _S  # ns between two notes in the store of when a login was used
_LOOK = 15.0  # s between looks for idle logins


class LoginAuthenticator(Authenticator):
    """Keeps the logins, and proves the principals that began them, with their rights of now.

    Such a principal has the proof of the credential it came with: a person is the same one by cookie and by
    key.
    """

    name = "logins"

    def __init__(self, config: LoginsConfig, host: FeatureHost) -> None:
        super().__init__()
        self._config = config
        self._host = host
        self._kept = host.store("logins")
        self._logins: dict[str, Login] = {}
        """By the hash of the secret."""
        self._ids: dict[str, Login] = {}
        self._noted: dict[str, int] = {}
        """When the use of a login was last put into the store, by id."""

    @property
    def durable(self) -> bool:
        """Whether logins outlive a restart of the gateway."""
        return self._kept.keeps

    def configure(self, config: LoginsConfig) -> None:
        """Apply another configuration."""
        self._config = config

    @asynccontextmanager
    async def running(self) -> AsyncGenerator[None]:
        """Keep the logins of earlier runs, and end those that nobody uses."""
        for digest, row in self._kept.load().items():
            try:
                self._add(msgspec.convert(row, Login))
            except msgspec.ValidationError as error:
                log.warning("login_unreadable", error=str(error))
                self._kept.put(digest, None)
        looking = self._host.loop.create_task(self._look())
        try:
            yield
        finally:
            looking.cancel()

    async def _look(self) -> None:
        while True:
            await asyncio.sleep(_LOOK)  # first: other authenticators are not running yet
            self._sweep()

    def _sweep(self) -> None:
        now = self._host.clock.now()
        connected = {s.principal.login for s in self._host.sessions.everyone() if s.connection}
        for login in list(self._logins.values()):
            if login.id in connected:
                self._use(login, now)
            if not self._lasts(login, now):
                self.close(login, "expired")
            elif self._principal(login) is None:
                self.close(login, "revoked")

    # -- the service of transports -------------------------------------------------------------

    def begin(self, principal: Principal, address: str | None, *, remember: bool) -> NewLogin:
        """Begin a login.

        :raises Forbidden: the principal came by a login, which must not prolong itself.
        :raises QueueFull: there are too many logins.
        """
        if principal.login is not None or principal.anonymous:
            raise Forbidden(
                "a login begins with a key or token, not with another login",
                remedy="Send the key or token itself.",
            )
        self._make_room(principal)
        now = self._host.clock.now()
        secret = _PREFIX + secrets.token_urlsafe(32)
        login = Login(
            id="l-" + secrets.token_hex(4),
            digest=fingerprint(secret),
            name=principal.name,
            proof=principal.proof,
            credential=principal.credential,
            grants=principal.grants,
            via=principal.via,
            expires=principal.expires,
            address=address,
            remembered=remember,
            begun=now,
            used=now,
        )
        self._add(login)
        self._save(login)
        self._note(login, "begun")
        expires = self.until(login)
        return NewLogin(secret, max(1, (expires - now) // _S), expires)

    def _make_room(self, principal: Principal) -> None:
        own = [one for one in self._logins.values() if same_rights(one.principal, principal)]
        if len(own) >= self._config.per_person:
            self.close(min(own, key=lambda one: one.used), "replaced")
        elif len(self._logins) >= self._config.most:
            raise QueueFull(
                f"there are already {len(self._logins)} logins",
                remedy="Try again later, or send the token with each request.",
                retry_after=_LOOK,
            )

    def find(self, secret: str) -> Principal | None:
        """Return the principal of a login; None if it has ended, or never began."""
        return self.proves(fingerprint(secret))

    def end(self, secret: str) -> None:
        """End a login, and its sessions at once."""
        login = self._logins.get(fingerprint(secret))
        if login is not None:
            self.close(login, "ended")

    # -- the authenticator ---------------------------------------------------------------------

    def recognises(self, token: str) -> bool:
        """Tell a secret by its prefix."""
        return token.startswith(_PREFIX)

    def verify(self, token: str, digest: str, *, fetched: bool = False) -> Principal | None:
        """Refuse a secret that `proves` does not know."""
        raise Unauthenticated("the login has ended", remedy="Log in again.")

    def proves(self, digest: str) -> Principal | None:
        """Return the principal of a login that has not ended."""
        login = self._logins.get(digest)
        if login is None:
            return None
        found = self._principal(login)
        if found is not None:
            self._use(login, self._host.clock.now())
        return found

    def renewed(self, principal: Principal) -> Principal | None:
        """Return the principal with its rights of now; None if its login or credential has ended."""
        login = self._ids.get(principal.login or "")
        return None if login is None else self._principal(login)

    # -- logins --------------------------------------------------------------------------------

    @property
    def every(self) -> list[Login]:
        """All logins that have not ended, oldest first."""
        now = self._host.clock.now()
        return [login for login in self._logins.values() if self._lasts(login, now)]

    def until(self, login: Login) -> int:
        """Return when a login ends at the latest, in ns since the UNIX epoch."""
        last = login.begun + int(self._config.lifetime * _S)
        return last if login.expires is None else min(last, login.expires)

    def owner(self, login: Login) -> Principal:
        """Return whose a login is, with the rights of now as far as there still are any."""
        return self._host.delegation.renewed(login.principal) or login.principal

    def get(self, id_: str) -> Login | None:
        """Return a login by its id."""
        return self._ids.get(id_)

    def close(self, login: Login, why: str) -> None:
        """End a login, and its sessions at once."""
        del self._logins[login.digest], self._ids[login.id]
        self._noted.pop(login.id, None)
        self._kept.put(login.digest, None)
        oidc = self._host.service(OIDC)
        if oidc is not None and login.credential is not None:
            oidc.release(login.credential)
        self._note(login, why)
        for changed in self.on_change:
            changed()

    def _add(self, login: Login) -> None:
        self._logins[login.digest] = self._ids[login.id] = login
        self._host.changed(PATH)

    def _note(self, login: Login, outcome: str) -> None:
        self._host.note(
            "browser_login",
            principal=login.principal,
            outcome=outcome,
            id=login.id,
            address=login.address,
        )
        self._host.changed(PATH)

    def _lasts(self, login: Login, now: int) -> bool:
        return now < min(self.until(login), login.used + int(self._config.idle * _S))

    def _use(self, login: Login, now: int) -> None:
        login.used = now
        if now - self._noted.get(login.id, login.begun) >= _NOTED:
            self._save(login)

    def _save(self, login: Login) -> None:
        self._noted[login.id] = login.used
        self._kept.put(login.digest, msgspec.to_builtins(login))

    def _principal(self, login: Login) -> Principal | None:
        if not self._lasts(login, self._host.clock.now()):
            return None
        now = self._host.delegation.renewed(login.principal)
        if now is None or now.identity != (login.name, login.proof):
            return None
        ends = self.until(login)
        expires = ends if now.expires is None else min(ends, now.expires)
        return msgspec.structs.replace(now, login=login.id, expires=expires)
