"""Keys in the store: listed and revoked by those who may, for good."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from configuration import backend, key, table
from rcp_gateway.testing import ScriptedRobot, scripted, serve
from rcp_gateway.testing._serve import Served
from rcp_kernel.config.file import parse
from rcp_kernel.spi import Host
from rcp_store.tokens import TokenFile

pytestmark = pytest.mark.anyio
PATH = "/system/keys"
ADMIN, HEAD, ALPHA = (f"{name}-of-this-test" for name in ("admin", "head", "alpha"))
CONFIG = (
    "anonymous = false\n[transports]\nasgi = false\nhttp = false\nws = false\nsse = false\n"
    + backend()
    + backend("second", "beta")
    + key("admin", ADMIN, roles={"*": ["admin"]})
    + key("head", HEAD, roles={"alpha": ["admin"]})
    + key("alfred", ALPHA, roles={"alpha": ["operator"]})
)
GRANTS: Mapping[str, tuple[tuple[str, tuple[str, ...]], ...]] = {
    "ann": (("alpha", ("operator",)),),
    "bob": (("alpha", ("operator",)), ("beta", ("viewer",))),
    "root": (("*", ("admin",)),),
}


@asynccontextmanager
async def serving(folder: Path) -> AsyncGenerator[Served]:
    config = parse(CONFIG + table("store", path=f"{folder}/store.db"), "test")
    async with serve(config, scripted(_robot)) as served:
        yield served


def _robot(host: Host) -> ScriptedRobot:
    return ScriptedRobot(host)


def made(folder: Path) -> dict[str, tuple[str, str]]:
    """Create a key for each person; return ids and keys by name."""
    keys = TokenFile(folder / "store.db")
    found = {name: keys.create(name, grants, None) for name, grants in GRANTS.items()}
    keys.close()
    return {name: (token.id, secret) for name, (token, secret) in found.items()}


async def test_who_may_sees_the_keys_but_never_what_proves_them(tmp_path: Path) -> None:
    keys = made(tmp_path)
    async with serving(tmp_path) as served:
        everything = await served.client(ADMIN).request("read", PATH)
        assert [one["principal"] for one in everything["body"]] == ["ann", "bob", "root"]
        bob = everything["body"][1]
        assert bob["grants"] == {"alpha": ["operator"], "beta": ["viewer"]}
        assert (bob["key"], bob["state"], bob["revoked"]) == (keys["bob"][0], "good", None)
        assert not [secret for _, secret in keys.values() if secret in str(everything)]
        of_alpha = await served.client(HEAD).request("read", PATH)
        assert [one["principal"] for one in of_alpha["body"]] == ["ann"]
        refused = await served.client(ALPHA).request("read", PATH)
        assert refused["error"]["code"] == "unknown_path"


async def test_a_revoked_key_ends_its_sessions_and_stays_revoked_after_a_restart(
    tmp_path: Path,
) -> None:
    keys = made(tmp_path)
    id_, secret = keys["ann"]
    async with serving(tmp_path) as served:
        page, other = served.client(secret), served.client(keys["bob"][1])
        head = served.client(HEAD)
        dry = await head.request("execute", PATH, body={"revoke": id_}, dry_run=True)
        assert dry["status"] == "completed"
        assert not page.connection.expelled
        done = await head.request("execute", PATH, body={"revoke": id_})
        assert (done["body"]["state"], done["body"]["principal"]) == ("revoked", "ann")
        assert page.connection.expelled
        assert not other.connection.expelled
        again = await head.request("execute", PATH, body={"revoke": id_})
        assert again["body"]["revoked"] == done["body"]["revoked"]
    async with serving(tmp_path) as served:
        assert served.server.gateway.identities.renewed(page.connection.session.principal) is None
        (ann,) = (await served.client(HEAD).request("read", PATH))["body"]
        assert ann["state"] == "revoked"


@pytest.mark.parametrize("whose", ["bob", "root"])
async def test_nobody_revokes_a_key_that_is_good_where_they_may_not(
    tmp_path: Path, whose: str
) -> None:
    id_, secret = made(tmp_path)[whose]
    async with serving(tmp_path) as served:
        page = served.client(secret)
        refused = await served.client(HEAD).request("execute", PATH, body={"revoke": id_})
        assert refused["error"]["code"] == "unknown_path"
        assert not page.connection.expelled
        of_operator = await served.client(ALPHA).request("execute", PATH, body={"revoke": id_})
        assert of_operator["error"]["code"] == "unknown_path"


async def test_a_gateway_without_a_store_has_no_keys_to_revoke() -> None:
    async with serve(parse(CONFIG, "test"), scripted(_robot)) as served:
        admin = served.client(ADMIN)
        assert (await admin.request("read", PATH))["body"] == []
        refused = await admin.request("execute", PATH, body={"revoke": "t-1"})
        assert refused["error"]["code"] == "unknown_path"


async def test_a_key_for_no_tenant_is_for_those_of_all_tenants_to_revoke(tmp_path: Path) -> None:
    keys = TokenFile(tmp_path / "store.db")
    keys.create("none", (), None)
    keys.close()
    async with serving(tmp_path) as served:
        (seen,) = (await served.client(ADMIN).request("read", PATH))["body"]
        assert seen["principal"] == "none"
        assert (await served.client(HEAD).request("read", PATH))["body"] == []
