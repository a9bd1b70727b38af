"""The authorization code flow with PKCE: people log in at an issuer, in their browsers.

OpenID Connect Core 3.1, RFC 7636 and RFC 9700. The gateway keeps nothing of a login under way: all of it is
in a sealed cookie of the browser, so that nobody can fill the memory by beginning logins. Of one that was
used it keeps the state, so that it is good once.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import secrets
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any
from urllib.parse import quote_plus, urlencode

import structlog

from rcp_jwt.authenticator import JwtAuthenticator
from rcp_jwt.documents import Answer, Unreachable, post, read_document
from rcp_jwt.issuers import Issuer
from rcp_jwt.login_config import LoginConfig
from rcp_jwt.provider import Provider
from rcp_jwt.seal import Pending, Seal
from rcp_jwt.spent import SpentStates
from rcp_jwt.urls import host_of, shown_url
from rcp_kernel.clock import Clock
from rcp_kernel.contract.identity import Principal
from rcp_kernel.errors import (
    AdapterUnavailable,
    Forbidden,
    TokenExpired,
    Unauthenticated,
    UnknownPath,
)
from rcp_protocol.plain import is_map
from rcp_protocol.timeouts import timeout
from rcp_web.oidc import Begun, IssuerLink, Parameters, Returned, Started
from rcp_web.own_page import is_same_origin

__all__ = ["CodeFlow"]

log = structlog.get_logger("rcp.jwt")
_LIFETIME = 600  # s that a person has for the issuer's page
_S = 1_000_000_000  # ns
_LONGEST = 2000  # characters of a code or a page: a cookie has at most 4096
_AT_ONCE = 8  # codes that are exchanged at the same time
_QUEUED = 10.0  # s that one more may wait
_OWN_FAULT = ("invalid_client", "unauthorized_client")  # of the gateway's table, not of the code
_AGAIN = "Log in again."
_REFUSED = {
    "access_denied": "the login was refused or cancelled at {name}",
    "temporarily_unavailable": "{name} cannot log anybody in at present",
    "server_error": "{name} failed to log you in",
}


class CodeFlow:
    """Logs people in at the issuers whose tables have a `login`."""

    def __init__(self, authenticator: JwtAuthenticator, clock: Clock) -> None:
        self._authenticator = authenticator
        self._now = clock.now
        self._seal = Seal()
        self._exchanges = asyncio.Semaphore(_AT_ONCE)
        self._spent = SpentStates(_LIFETIME * _S)

    @property
    def issuers(self) -> list[IssuerLink]:
        """Where people log in."""
        return [_link(issuer, login) for issuer, login in self._logins()]

    def link(self, id_: str) -> IssuerLink:
        """Return where people log in at one issuer."""
        return _link(*self._find(id_))

    def root(self, id_: str) -> str:
        """Return the address of the gateway in browsers."""
        return self._find(id_)[1].root

    def is_on_tls(self, host: bytes) -> bool:
        """Return whether `host` is the address of the gateway in browsers, over TLS."""
        return any(is_same_origin(login.origin, host, secure=True) for _, login in self._logins())

    def release(self, credential: str) -> None:
        """Forget what a person has logged in with."""
        self._authenticator.release(credential)

    def log_out(self, principal: Principal) -> IssuerLink | None:
        """Return where a person logs out of the issuer too."""
        for issuer, login in self._logins():
            place = None if issuer.provider is None else issuer.provider.end_session
            if place is not None and principal.proof == f"jwt {issuer.config.issuer}":
                url = _with(place, {"client_id": login.client_id})
                return IssuerLink(_name(issuer, login), url)
        return None

    async def begin(self, id_: str, started: Started) -> Begun:
        """Begin a login."""
        issuer, login = self._find(id_)
        _check_page(started.next)
        provider = await _provider(issuer)
        if provider.authorization is None or provider.token is None:
            raise _unavailable(_name(issuer, login), "it does not offer the login of people")
        state, nonce, verifier = (secrets.token_urlsafe(32) for _ in range(3))
        digest = hashlib.sha256(verifier.encode()).digest()
        asked = {
            "response_type": "code",
            "client_id": login.client_id,
            "redirect_uri": login.redirect_uri,
            "scope": " ".join(dict.fromkeys(("openid", *login.scopes))),
            "state": state,
            "nonce": nonce,
            "code_challenge": base64.urlsafe_b64encode(digest).decode().rstrip("="),
            "code_challenge_method": "S256",
        }
        pending = Pending(id_, self._now(), state, nonce, verifier, *started)
        return Begun(_with(provider.authorization, asked), self._seal.close(pending), _LIFETIME)

    def returned(self, id_: str, sealed: str | None, given: Parameters) -> Returned:
        """Check that a browser comes back from a login that it began itself."""
        issuer, login = self._find(id_)
        name = _name(issuer, login)
        pending = None if sealed is None else self._seal.open(sealed)
        if pending is None or self._now() > pending.began + _LIFETIME * _S:
            raise Forbidden(
                "this browser has begun no login, or took too long, or the gateway was restarted",
                remedy=f"{_AGAIN} The browser must accept cookies.",
            )
        state = given.get("state", "")
        if pending.id != id_ or not hmac.compare_digest(state.encode(), pending.state.encode()):
            raise Forbidden(
                "this is not the answer to the login that this browser began last", remedy=_AGAIN
            )
        self._check_issuer(issuer, given)
        if (error := given.get("error")) is not None:
            log.warning("oidc_refused", issuer=shown_url(issuer.config.issuer), error=error[:80])
            text = _REFUSED.get(error, "{name} did not accept how this gateway asks for a login")
            remedy = _AGAIN if error in _REFUSED else "Ask the operator to read the gateway's log."
            raise Forbidden(text.format(name=name), remedy=remedy)
        code = given.get("code", "")
        if not 0 < len(code) <= _LONGEST:
            raise Forbidden(f"the answer of {name} has no code", remedy=_AGAIN)
        started = Started(pending.next, pending.remember, pending.former)
        return Returned(started, pending.state, pending.nonce, pending.verifier, code)

    def _check_issuer(self, issuer: Issuer, given: Parameters) -> None:
        """Refuse an answer of another issuer (RFC 9207)."""
        named = given.get("iss")
        needed = issuer.provider is not None and issuer.provider.tells_issuer
        if (named is not None or needed) and named != issuer.config.issuer:
            raise Forbidden("the answer is of another issuer than this login", remedy=_AGAIN)

    async def finish(self, id_: str, returned: Returned) -> Principal:
        """Return who has logged in."""
        if not self._spent.use(returned.state, self._now()):
            raise Forbidden("this login was used already", remedy=_AGAIN)
        issuer, login = self._find(id_)
        name = _name(issuer, login)
        token = await self._exchange(issuer, login, returned)
        current, wanted = self._find(id_)  # the tables may have been changed meanwhile
        if (current.config.issuer, wanted) != (issuer.config.issuer, login):
            raise Forbidden("this login was changed on the gateway meanwhile", remedy=_AGAIN)
        issuers = self._authenticator.current
        try:
            return await issuers.log_in(current, wanted, token, returned.nonce)
        except (Unauthenticated, TokenExpired) as error:
            shown = shown_url(issuer.config.issuer)
            log.warning("oidc_token_refused", issuer=shown, reason=error.message)
            raise Unauthenticated(
                f"the answer of {name} was not accepted: {error.message}",
                remedy=f"{_AGAIN} If it persists, ask the operator to check `[jwt.login]`.",
            ) from None

    async def _exchange(self, issuer: Issuer, login: LoginConfig, returned: Returned) -> str:
        """Return the ID token for a code."""
        name = _name(issuer, login)
        provider = await _provider(issuer)
        if provider.token is None:
            raise _unavailable(name, "it does not offer the login of people")
        form, headers = _request(login, returned, posts_secret=provider.posts_secret)
        try:
            async with self._turn(name):
                answer = await post(provider.token, form, headers)
        except Unreachable as error:
            log.warning(
                "oidc_unreachable", issuer=shown_url(issuer.config.issuer), reason=str(error)
            )
            raise _unavailable(name, "it does not answer") from None
        return _id_token(issuer, name, answer)

    @asynccontextmanager
    async def _turn(self, name: str) -> AsyncGenerator[None]:
        """Wait until few enough codes are being exchanged."""
        try:
            async with timeout(_QUEUED):
                await self._exchanges.acquire()
        except TimeoutError:
            raise _unavailable(name, "too many people log in at once") from None
        try:
            yield
        finally:
            self._exchanges.release()

    def _logins(self) -> list[tuple[Issuer, LoginConfig]]:
        issuers = self._authenticator.current.issuers.values()
        return [(one, one.config.login) for one in issuers if one.config.login is not None]

    def _find(self, id_: str) -> tuple[Issuer, LoginConfig]:
        for issuer, login in self._logins():
            if login.id == id_:
                return issuer, login
        raise UnknownPath(
            "this gateway has no such login", remedy="Open the gateway's page and log in there."
        )


async def _provider(issuer: Issuer) -> Provider:
    if issuer.provider is None:
        await issuer.ask()
    if issuer.provider is None:
        raise _unavailable(host_of(issuer.config.issuer), "it does not answer")
    return issuer.provider


def _unavailable(name: str, reason: str) -> AdapterUnavailable:
    return AdapterUnavailable(
        f"{name} cannot log anybody in at present: {reason}",
        remedy="Try again. If it persists, ask the operator to check the issuer.",
        retry_after=3,
    )


def _name(issuer: Issuer, login: LoginConfig) -> str:
    return login.name or host_of(issuer.config.issuer)


def _link(issuer: Issuer, login: LoginConfig) -> IssuerLink:
    return IssuerLink(_name(issuer, login), login.begins_at)


def _with(url: str, parameters: Parameters) -> str:
    return f"{url}{'&' if '?' in url else '?'}{urlencode(parameters)}"


def _check_page(page: str) -> None:
    """Refuse what is no page: it is appended to the gateway's own address, whose host it cannot leave."""
    if not page.startswith("/") or not page.isprintable() or len(page.encode()) > _LONGEST // 2:
        raise Forbidden(
            "`next` is not a page of this gateway",
            remedy="Write a path from the gateway's root, such as `/#/fleet`.",
        )


def _request(
    login: LoginConfig, returned: Returned, *, posts_secret: bool
) -> tuple[bytes, dict[str, str]]:
    """Return the form and headers by which a code is exchanged (RFC 6749, 2.3.1 and 4.1.3)."""
    form = {
        "grant_type": "authorization_code",
        "code": returned.code,
        "redirect_uri": login.redirect_uri,
        "code_verifier": returned.verifier,
    }
    headers: dict[str, str] = {}
    secret = login.client_secret
    if secret is None or posts_secret:
        form["client_id"] = login.client_id
    if secret is not None and posts_secret:
        form["client_secret"] = secret
    elif secret is not None:
        pair = f"{quote_plus(login.client_id)}:{quote_plus(secret)}".encode()
        headers["Authorization"] = f"Basic {base64.b64encode(pair).decode()}"
    return urlencode(form).encode(), headers


def _id_token(issuer: Issuer, name: str, answer: Answer) -> str:
    """Return the ID token of a token response."""
    try:
        found: Any = read_document(answer.body)
    except ValueError:
        found = None
    told: dict[str, Any] = found if is_map(found) else {}
    token, error = told.get("id_token"), told.get("error")
    if answer.status == 200 and isinstance(token, str):
        return token
    log.warning(
        "oidc_code_refused",
        issuer=shown_url(issuer.config.issuer),
        status=answer.status,
        error=str(error)[:80],
    )
    if error == "invalid_grant":
        raise Unauthenticated(
            f"{name} did not accept the code of this login: it was used already, or is too old",
            remedy=_AGAIN,
        )
    if error in _OWN_FAULT:
        raise _unavailable(
            name, "it does not accept `client_id` or `client_secret` of this gateway"
        )
    if 400 <= answer.status < 500:  # whatever it is called: it counts as a wrong code
        raise Unauthenticated(
            f"{name} did not accept the code of this login",
            remedy=f"{_AGAIN} If it persists, ask the operator to read the gateway's log.",
        )
    raise _unavailable(name, "its answer is not the one expected")
