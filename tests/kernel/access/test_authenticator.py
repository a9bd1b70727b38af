"""What a feature that verifies tokens may rely on, and what the gateway does not leave to it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

import msgspec
import pytest
from structlog.testing import capture_logs

from kernel.world import CONFIG, World, prepared
from rcp_gateway.features import ActiveFeature
from rcp_gateway.server import running
from rcp_kernel.access.authenticator import Authenticator
from rcp_kernel.config.file import parse
from rcp_kernel.contract.identity import Principal, fingerprint, granted
from rcp_kernel.contract.peer import Peer
from rcp_kernel.errors import (
    InternalError,
    PluginError,
    RateLimited,
    RcpError,
    Unauthenticated,
)
from rcp_kernel.features import Feature, FeatureKind

pytestmark = pytest.mark.anyio
EVERYTHING = granted(("*",), ("operator",))


class NoTable(msgspec.Struct):
    """Nothing to configure."""


class Directory(Authenticator):
    """Knows the tokens that a test lists; some of them only after a fetch."""

    def __init__(self, name: str = "directory", prefix: str = "dir_") -> None:
        super().__init__()
        self.name = name
        self.proof = f"{name} of the test"
        self.prefix = prefix
        self.users: dict[str, str] = {}
        self.away: dict[str, str] = {}
        self.seen: list[str] = []
        self.error: Exception | None = None
        self.revoked: set[str] = set()

    def recognises(self, token: str) -> bool:
        return token.startswith(self.prefix)

    def verify(self, token: str, digest: str, *, fetched: bool = False) -> Principal | None:
        self.seen.append(token)
        if self.error is not None:
            raise self.error
        if token in self.users:
            return Principal(self.users[token], EVERYTHING, self.proof, digest)
        if token in self.away and not fetched:
            return None
        raise Unauthenticated("the directory does not know this token")

    async def fetch(self, token: str, digest: str) -> None:
        if token in self.away:
            self.users[token] = self.away.pop(token)

    def renewed(self, principal: Principal) -> Principal | None:
        return None if principal.name in self.revoked else principal


@asynccontextmanager
async def world_with(*authenticators: Authenticator) -> AsyncGenerator[World]:
    robots = []
    features = tuple(
        ActiveFeature(
            FeatureKind(one.name, NoTable, lambda _, __, made=one: Feature(authenticator=made)),
            NoTable(),
        )
        for one in authenticators
    )
    made = msgspec.structs.replace(prepared(parse(CONFIG, "test"), robots), features=features)
    async with running(made) as server:
        yield World(server, robots)


async def test_a_token_of_the_feature_opens_a_session() -> None:
    directory = Directory()
    directory.users["dir_ann"] = "ann"
    async with world_with(directory) as world:
        assert world.server.client_api.authenticate("dir_ann").name == "ann"
        assert world.server.client_api.proofs.bearer
        reply = await world.client("dir_ann").ask(type="read", path="/param/limit")
        assert reply["status"] == "completed"


async def test_the_gateways_own_keys_come_first_and_are_shown_to_nobody() -> None:
    everything = Directory(prefix="")
    async with world_with(everything) as world:
        assert world.server.client_api.authenticate("operator-operator").proof == "key"
    assert everything.seen == []


async def test_a_token_goes_to_the_first_by_name_that_recognises_it_and_to_no_other() -> None:
    late, early = Directory("b"), Directory("a")
    late.users["dir_ann"] = "ann"
    async with world_with(late, early) as world:
        with pytest.raises(Unauthenticated, match="does not know"):
            world.server.client_api.authenticate("dir_ann")
    assert (early.seen, late.seen) == (["dir_ann"], [])


async def test_a_token_that_nobody_recognises_is_unknown() -> None:
    async with world_with(Directory()) as world:
        with pytest.raises(Unauthenticated, match="unknown token"):
            world.server.client_api.authenticate("other")


async def test_what_has_to_be_fetched_is_waited_for() -> None:
    directory = Directory()
    directory.away["dir_bea"] = "bea"
    async with world_with(directory) as world:
        assert world.server.client_api.known("dir_bea") is None
        assert (await world.server.client_api.identify("dir_bea")).name == "bea"
        assert world.server.client_api.authenticate("dir_bea").name == "bea"


@pytest.mark.parametrize("place", ["verify", "recognises", "fetch"])
async def test_what_a_feature_raises_is_told_by_its_kind_and_place_alone(
    place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory, secret = Directory(), "dir_secret-of-the-test"

    def fail(token: str, *_: object, **__: object) -> None:
        raise LookupError(token)

    async def fail_to_fetch(token: str, digest: str) -> None:
        raise LookupError(token)

    directory.away[secret] = "ann"
    monkeypatch.setattr(directory, place, fail_to_fetch if place == "fetch" else fail)
    async with world_with(directory) as world:
        with capture_logs() as logs, pytest.raises(RcpError) as refused:
            await world.server.client_api.identify(secret)
    assert isinstance(refused.value, InternalError) or place == "fetch"
    [failure] = [one for one in logs if one["event"] == "authenticator_failed"]
    assert (failure["error"], failure["file"]) == ("LookupError", __file__)
    assert secret not in f"{logs}{refused.value}{refused.value.__cause__}"


@pytest.mark.parametrize("proof", ["key", "token", "certificate", "none", "other", "directory-2"])
async def test_a_feature_speaks_for_its_own_principals_alone(proof: str) -> None:
    directory = Directory()
    directory.users["dir_ann"] = "operator"
    directory.proof = proof
    async with world_with(directory) as world:
        with pytest.raises(InternalError):
            world.server.client_api.authenticate("dir_ann")


@pytest.mark.parametrize("name", ["key", "token", "certificate", "none"])
async def test_no_feature_has_the_name_of_a_proof_of_the_gateway(name: str) -> None:
    with pytest.raises(PluginError, match=name):
        async with world_with(Directory(name)):
            pass


async def test_who_is_revoked_loses_the_session_and_nobody_else_does() -> None:
    directory = Directory()
    directory.users |= {"dir_ann": "ann", "dir_bea": "bea"}
    async with world_with(directory) as world:
        ann, bea = world.client("dir_ann"), world.client("dir_bea")
        await ann.ask(type="ping")
        await bea.ask(type="ping")
        directory.revoked.add("ann")
        for changed in directory.on_change:
            changed()
        assert (await ann.final(None))["error"]["code"] == "token_expired"
        assert (await bea.ask(type="ping"))["status"] == "completed"


async def test_a_token_that_was_verified_and_expires_is_refused() -> None:
    class Brief(Directory):
        def verify(self, token: str, digest: str, *, fetched: bool = False) -> Principal | None:
            return Principal("ann", EVERYTHING, self.proof, digest, expires=1)

    async with world_with(Brief()) as world:
        with pytest.raises(RcpError) as refused:
            world.server.client_api.authenticate("dir_ann")
        assert refused.value.code == "token_expired"


@pytest.mark.parametrize("signed", [False, True])
async def test_guesses_are_slowed_unless_the_tokens_cannot_be_guessed(*, signed: bool) -> None:
    directory, peer = Directory(), Peer("192.0.2.1")
    directory.signed = signed
    directory.users["dir_ann"] = "ann"
    async with world_with(directory) as world:
        client_api = world.server.client_api
        for number in range(30):
            with pytest.raises(Unauthenticated):
                client_api.known(f"guess-{number}", peer)
        with pytest.raises(RateLimited):
            client_api.known("guess", peer)
        assert client_api.known("operator-operator", peer) is not None
        if signed:
            async with asyncio.timeout(60):
                while True:  # at the pace of signatures after a wrong token
                    try:
                        assert client_api.known("dir_ann", peer) is not None
                        break
                    except RateLimited as error:
                        await asyncio.sleep(error.retry_after or 0.01)
        else:
            with pytest.raises(RateLimited):
                client_api.known("dir_ann", peer)
            assert "dir_ann" not in directory.seen


async def test_what_was_verified_before_is_found_by_its_hash_alone() -> None:
    class Remembering(Directory):
        def proves(self, digest: str) -> Principal | None:
            if digest != fingerprint("dir_ann"):
                return None
            return Principal("ann", EVERYTHING, self.proof, digest)

    directory, peer = Remembering(), Peer("192.0.2.1")
    async with world_with(directory) as world:
        for number in range(30):
            with pytest.raises(Unauthenticated):
                world.server.client_api.known(f"guess-{number}", peer)
        assert world.server.client_api.known("dir_ann", peer) is not None
    assert directory.seen == []
