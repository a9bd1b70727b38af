from __future__ import annotations

import sqlite3
import sys
from contextlib import closing
from pathlib import Path

import anyio
import pytest

from configuration import key
from kernel.world import CONFIG, world_of
from rcp_kernel.clock import now
from rcp_kernel.contract.identity import fingerprint
from rcp_kernel.errors import RateLimited, TokenExpired, Unauthenticated
from rcp_store.tokens import PREFIX, TokenFile

pytestmark = pytest.mark.anyio

_RCPD = "from rcpd.cli import main; main()"


@pytest.fixture
def store(tmp_path: Path) -> Path:
    return tmp_path / "store.db"


@pytest.fixture
def text(store: Path) -> str:
    return f'[store]\npath = "{store}"\n' + CONFIG


@pytest.fixture
def config(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "rcp.toml"
    file.write_text(text)
    return file


async def rcpd(*words: str) -> str:
    """Run the command line in a process of its own; return what it prints."""
    done = await anyio.run_process([sys.executable, "-c", _RCPD, "token", *words])
    return done.stdout.decode()


async def test_a_token_is_good_and_is_taken_back_while_the_gateway_runs(
    config: Path, text: str
) -> None:
    async with world_of(text) as world:
        key = (await rcpd("create", "arm", "--config", str(config), "--role", "operator")).strip()
        assert key.startswith(PREFIX)
        assert len(key) >= 40
        with anyio.fail_after(60):
            while True:
                try:
                    client = world.client(key)
                    break
                except Unauthenticated:
                    await anyio.sleep(0.02)
        hello = await client.ask(type="hello")
        assert (hello["body"]["principal"], hello["body"]["roles"]) == ("arm", ["operator"])
        assert (await client.ask(type="write", path="/param/limit", body=1.0))[
            "status"
        ] == "completed"
        await client.ask(type="subscribe", path="/sensor/level", id="s")
        listed = await rcpd("list", "--config", str(config))
        assert "arm" in listed
        assert key not in listed
        assert "revoked" in await rcpd("revoke", "arm", "--config", str(config))
        with anyio.fail_after(60):
            ended = await client.notice("subscription_ended")
        assert (ended["id"], ended["error"]["code"]) == ("s", "token_expired")
        assert (await client.final(None))["error"]["code"] == "token_expired"
        assert client.connection.expelled
        with pytest.raises(Unauthenticated):
            world.client(key)


def test_only_the_hash_of_a_key_is_kept(store: Path) -> None:
    with closing(TokenFile(store)) as table:
        made, key = table.create("arm", (("*", ("viewer",)),), None)
        assert made.hash == fingerprint(key)
        assert store.stat().st_mode & 0o077 == 0
    assert key.encode() not in b"".join(f.read_bytes() for f in store.parent.iterdir())


async def test_an_expired_token_says_so(text: str, store: Path) -> None:
    with closing(TokenFile(store)) as table:
        _, key = table.create("arm", (("*", ("viewer",)),), 1)
    async with world_of(text) as world:
        with pytest.raises(TokenExpired):
            world.client(key)


async def test_a_role_that_the_configuration_lost_gives_nothing(text: str, store: Path) -> None:
    with closing(TokenFile(store)) as table:
        _, key = table.create("arm", (("alpha", ("viewer", "gone")), ("lost", ("admin",))), None)
    async with world_of(text) as world:
        hello = await world.client(key).ask(type="hello")
        assert (hello["body"]["roles"], hello["body"]["tenants"]) == (["viewer"], ["alpha"])


async def test_a_key_of_the_configuration_expires() -> None:
    def old(expires: str) -> str:
        return CONFIG + key("old", "key-that-is-old-now", role="viewer", expires=expires)

    async with world_of(old("2020-01-01")) as world:
        with pytest.raises(TokenExpired):
            world.client("key-that-is-old-now")
    async with world_of(old("2200-01-01")) as world:
        world.client("key-that-is-old-now")


async def test_guessing_is_slowed_and_who_has_a_right_key_comes_in() -> None:
    from rcp_kernel.contract.peer import Peer

    async with world_of(CONFIG + "[limits]\nfailed_logins = 5\n") as world:
        client_api = world.server.client_api
        here, there = Peer("192.0.2.1"), Peer("192.0.2.2")
        for number in range(5):
            with pytest.raises(Unauthenticated):
                client_api.authenticate(f"guess-{number}", here)
        with pytest.raises(RateLimited) as limited:
            client_api.authenticate("guess-again", here)
        assert 0 < (limited.value.retry_after or 0) <= 12
        assert client_api.authenticate("admin-admin-admin", here).name == "admin"
        assert client_api.authenticate(None, here).anonymous
        with pytest.raises(Unauthenticated):
            client_api.authenticate("guess-elsewhere", there)


async def test_a_gateway_without_the_feature_knows_only_the_keys_of_its_configuration(
    text: str, store: Path
) -> None:
    with closing(TokenFile(store)) as table:
        _, key = table.create("arm", (("*", ("viewer",)),), None)
    async with world_of(text + "\n[features]\ntokens = false\n") as world:
        world.client()
        with pytest.raises(Unauthenticated):
            world.client(key)


def test_the_number_of_changes_grows_though_old_keys_are_deleted(store: Path) -> None:
    """A running gateway looks at it: one that has been there already hides a new key from it."""
    grants = (("*", ("viewer",)),)
    with closing(TokenFile(store)) as table:
        table.create("stays", grants, None)
        table.create("goes", grants, None)
        table.revoke("goes")
        seen = table.version()
        with closing(sqlite3.connect(store)) as base, base:
            base.execute("UPDATE tokens SET revoked = 1 WHERE name = 'goes'")
        table.create("new", grants, None)
        assert [one.name for one in table.every()] == ["stays", "new"]
        assert table.version() > seen


def test_a_clock_that_is_ahead_deletes_no_valid_keys(
    store: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    grants, moment = (("*", ("viewer",)),), now()
    with closing(TokenFile(store)) as table:
        table.create("valid", grants, moment + 3_600 * 10**9)
        monkeypatch.setattr("rcp_store.tokens.now", lambda: moment + 3_650 * 86_400 * 10**9)
        table.create("new", grants, None)
        assert [(one.name, one.state(moment)) for one in table.every()] == [
            ("valid", "good"),
            ("new", "good"),
        ]
