"""The authenticator: from a hub's assertion to the person it stands for."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import structlog

from rcp_hubs.assertion import LONGEST, OWN_PROOF, Assertion, is_assertion, verified
from rcp_hubs.config import HubConfig, HubTables, public_keys
from rcp_hubs.revocation import NONE, RevocationList, fleet_key, read_list
from rcp_jwt.webtokens import read_token
from rcp_kernel.access.authenticator import Authenticator
from rcp_kernel.config.role import HUB
from rcp_kernel.contract.identity import NAMED_BY_OPERATOR, Principal, granted
from rcp_kernel.errors import Forbidden, TokenExpired, Unauthenticated
from rcp_kernel.features import FeatureHost

__all__ = ["HubAuthenticator"]

log = structlog.get_logger("rcp.identity")
_S = 1_000_000_000  # ns
_CLOCKS = "Compare the clocks of the hub and of this gateway, which should be set by NTP."


class _Accepted(msgspec.Struct, frozen=True):
    """An assertion that was accepted, until it expires."""

    assertion: Assertion
    key: str
    """Thumbprint of the key that signed it."""


class HubAuthenticator(Authenticator):
    """Verifies assertions of hubs; `proof` is `hub <people>`.

    The proof at the hub follows if the hub's operator did not assign the name.
    """

    name = "hub"
    signed = True

    def __init__(self, tables: HubTables, host: FeatureHost) -> None:
        """Read the keys.

        :raises ConfigError: a key is invalid, or two tables have the same id.
        """
        super().__init__()
        self._clock, self._note = host.clock, host.note
        self._lists = host.store("revoked")
        self._revocations = NONE
        self._used = host.store("used")
        """Ids of accepted assertions with their expiry, so that none is accepted twice."""
        self._ids: dict[str, int] = {}
        self._accepted: dict[str, _Accepted] = {}
        self._apply(tables)

    @asynccontextmanager
    async def running(self) -> AsyncGenerator[None]:
        """Load the ids of an earlier run."""
        self._ids.update(self._used.load())
        kept = self._lists.load().get("list")
        if kept is not None:
            self._revocations = msgspec.convert(kept, RevocationList)
        yield

    def reconfigure(self, tables: HubTables) -> None:
        """Apply new tables; the caller reviews the sessions.

        :raises ConfigError: as for the constructor.
        """
        self._apply(tables)

    def _apply(self, tables: HubTables) -> None:
        self._keys = public_keys(tables.hubs)
        self._tables = tables
        given = tables.fleet_key
        self._fleet_key = None if given is None else fleet_key(given)
        self._last = b""  # another key may make a refused list good
        self._hubs = {hub.id: hub for hub in tables.hubs}

    def take_revocations(self, data: bytes) -> None:
        """Adopt a list of revoked keys if it is newer, and end the sessions of their hubs."""
        if self._fleet_key is None or data == self._last:
            return
        self._last = data
        try:
            found = read_list(data, self._fleet_key)
        except Unauthenticated as error:
            log.warning("hub_revocations_refused", reason=error.message)
            return
        if found.number <= self._revocations.number:
            return
        self._revocations = found
        self._lists.put("list", msgspec.to_builtins(found))
        held = {key.thumbprint: hub for hub, keys in self._keys.items() for key in keys}
        hubs = sorted({held[key] for key in found.keys if key in held})
        log.warning("hubs_revoked", number=found.number, hubs=hubs)
        self._note("revocation", principal=None, number=found.number, hubs=hubs)
        for changed in self.on_change:
            changed()

    def recognises(self, token: str) -> bool:
        """Return whether a token has the form of an assertion and any hub is configured."""
        return bool(self._hubs) and is_assertion(token)

    def verify(self, token: str, digest: str, *, fetched: bool = False) -> Principal:
        """Return the person that a hub asserts."""
        read = read_token(token)
        hub = self._hubs.get(read.issuer)
        if hub is None:
            raise Unauthenticated(
                f"hub '{read.issuer[:64]}' is not known to this gateway",
                remedy="Add it to [[hubs]] of this gateway, or enrol the gateway with that hub.",
            )
        assertion, key = verified(token, self._keys[hub.id])
        if key.thumbprint in self._revocations.keys:
            raise Unauthenticated(
                f"the key of hub '{hub.id}' was revoked",
                remedy="Give the hub a new key, and its public key to the robots.",
            )
        self._check_place(assertion)
        self._check_time(assertion, hub)
        self._use(assertion, hub)
        self._check_roles(assertion, hub)
        self._accepted[digest] = _Accepted(assertion, key.thumbprint)
        return self._principal(hub, assertion, digest)

    def _check_place(self, assertion: Assertion) -> None:
        if assertion.aud != self._tables.audience:
            raise Unauthenticated(
                f"hub '{assertion.iss}' asserts '{assertion.sub}' to the gateway "
                f"'{assertion.aud}', which is not this one"
            )

    def _check_time(self, assertion: Assertion, hub: HubConfig) -> None:
        now = self._clock.now() / _S
        who = f"the assertion of '{assertion.sub}' by hub '{hub.id}'"
        if not 0 < assertion.exp - assertion.iat <= LONGEST:
            raise Unauthenticated(f"{who} must be valid for at most {LONGEST} s")
        if assertion.iat > now + hub.leeway:
            ahead = assertion.iat - now
            raise Unauthenticated(f"{who} was made {ahead:.0f} s in the future", remedy=_CLOCKS)
        if assertion.exp + hub.leeway <= now:
            raise TokenExpired(
                f"{who} expired {now - assertion.exp:.0f} s ago",
                remedy=f"Send a new one. {_CLOCKS}",
            )

    def _use(self, assertion: Assertion, hub: HubConfig) -> None:
        """Note that an assertion was used.

        :raises Unauthenticated: it was used before.
        """
        now = self._clock.now()
        for id_ in [one for one, expires in self._ids.items() if expires <= now]:
            del self._ids[id_]
            self._used.put(id_, None)
        for digest in [
            one
            for one, held in self._accepted.items()
            if (held.assertion.exp + LONGEST) * _S <= now  # the longest leeway
        ]:
            del self._accepted[digest]
        id_ = f"{hub.id}:{assertion.jti}"
        if id_ in self._ids:
            raise Unauthenticated(
                f"the assertion of '{assertion.sub}' by hub '{hub.id}' was used before",
                remedy="Sign a new assertion for each `hello`.",
            )
        self._ids[id_] = int((assertion.exp + hub.leeway) * _S)
        self._used.put(id_, self._ids[id_])

    def _check_roles(self, assertion: Assertion, hub: HubConfig) -> None:
        excess = set(assertion.rcp_roles) - _assertable(hub, assertion)
        if excess:
            shown = ", ".join(sorted(excess))[:200]
            raise Forbidden(
                f"hub '{hub.id}' may not assert the role {shown} for '{assertion.sub}'",
                remedy="Add the role to `roles` of this hub in [[hubs]] of the robot's gateway.",
            )

    def _principal(self, hub: HubConfig, assertion: Assertion, digest: str) -> Principal:
        proof = f"{self.name} {hub.people or hub.id}"
        if assertion.rcp_proof not in NAMED_BY_OPERATOR:
            proof = f"{proof} {assertion.rcp_proof}"
        return Principal(
            assertion.sub,
            granted(self._tables.tenants_of(hub), assertion.rcp_roles),
            proof,
            digest,
            int((assertion.exp + hub.leeway) * _S),
            hub.id,
        )

    def renewed(self, principal: Principal) -> Principal | None:
        """Return a person with its current rights; None if its hub lost its key or the roles."""
        held = self._accepted.get(principal.credential or "")
        if held is None:
            return None
        hub = self._hubs.get(held.assertion.iss)
        if (
            held.key in self._revocations.keys
            or hub is None
            or all(key.thumbprint != held.key for key in self._keys[hub.id])
        ):
            return None
        if set(held.assertion.rcp_roles) - _assertable(hub, held.assertion):
            return None
        return self._principal(hub, held.assertion, principal.credential or "")

    @property
    def serves(self) -> bool:
        """Whether any hub may assert a role that grants anything."""
        held = {role for hub in self._hubs.values() for role in hub.roles}
        return not held.isdisjoint(self._tables.effective_roles)

    @property
    def facts(self) -> Sequence[dict[str, Any]]:
        """The hubs, for the health report."""
        return [{"name": f"hub {one}", "state": "ready"} for one in self._hubs]


def _assertable(hub: HubConfig, assertion: Assertion) -> set[str]:
    """Return the roles that a hub may assert; for itself, also the one that only looks."""
    own = assertion.sub == hub.id and assertion.rcp_proof == OWN_PROOF
    return {*hub.roles, HUB} if own else set(hub.roles)
