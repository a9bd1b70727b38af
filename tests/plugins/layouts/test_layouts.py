"""Layouts are each user's own or shared in a tenant, and no save undoes another one unseen."""

from __future__ import annotations

import sqlite3
from collections.abc import AsyncGenerator
from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import pytest

import rcp_layouts
from configuration import backend, key, role, rule, table
from rcp_gateway.testing import (
    FeatureGateway,
    FeatureSuite,
    MemoryClient,
    ScriptedRobot,
    scripted,
    serve,
)
from rcp_gateway.testing._serve import Served
from rcp_kernel.spi import Host

pytestmark = pytest.mark.anyio
(KIND,) = rcp_layouts.rcp_features()
OWN, SHARED = "/system/layouts", "/system/shared_layouts"
ADMIN, ALPHA, ALSO, BETA, LOOKS, BLIND, MIXED = (
    f"{name}-{name}-{name}-{name}"
    for name in ("admin", "alpha", "also", "beta", "looks", "blind", "mixed")
)
CONFIG = (
    backend(use="still")
    + backend("other", "beta", use="still")
    + role("blind", rule("*", "/tenant/**"))
    + key("admin", ADMIN, roles={"*": ["admin"]})
    + key("alfred", ALPHA, roles={"alpha": ["operator"]})
    + key("anna", ALSO, roles={"alpha": ["operator"]})
    + key("berta", BETA, roles={"beta": ["operator"]})
    + key("lena", LOOKS, roles={"alpha": ["viewer"]})
    + key("blind", BLIND, roles={"alpha": ["blind"]})
    + key("mixed", MIXED, roles={"alpha": ["operator"], "beta": ["viewer"]})
)
NOTE: dict[str, Any] = {"columns": [{"panels": [{"kind": "note", "text": "one"}]}]}
OTHER: dict[str, Any] = {"columns": []}


def still(host: Host) -> ScriptedRobot:
    return ScriptedRobot(host)


def served(config: str = CONFIG) -> Any:
    return serve(config, scripted(still, "still"))


@pytest.fixture
async def site() -> AsyncGenerator[Served]:
    async with served() as made:
        yield made


async def own(client: MemoryClient, do: str, name: str = "main", **more: Any) -> dict[str, Any]:
    return await client.request("execute", OWN, body={"do": do, "name": name, **more})


async def shared(client: MemoryClient, do: str, name: str = "main", **more: Any) -> dict[str, Any]:
    return await client.request("execute", SHARED, body={"do": do, "name": name, **more})


async def names(client: MemoryClient, path: str) -> list[str]:
    reply = await client.request("read", path)
    assert "error" not in reply, reply
    return [one["name"] for one in reply["body"]]


async def test_a_layout_is_saved_opened_listed_and_removed(site: Served) -> None:
    alfred = site.client(ALPHA)
    watching = await alfred.subscribe(OWN)
    assert (await alfred.update(watching))["body"] == []
    saved = (await own(alfred, "save", content=NOTE))["body"]
    assert (saved["version"], saved["by"]) == (1, "alfred")
    assert "content" not in saved
    assert [one["version"] for one in (await alfred.update(watching))["body"]] == [1]
    assert (await own(alfred, "open"))["body"]["content"] == NOTE
    assert (await own(alfred, "remove", version=1))["status"] == "completed"
    assert await names(alfred, OWN) == []
    assert (await own(alfred, "open"))["error"]["code"] == "unknown_path"


async def test_a_save_from_an_older_version_is_refused_and_says_who_saved_it(site: Served) -> None:
    alfred, anna = site.client(ALPHA), site.client(ALSO)
    await shared(alfred, "save", content=NOTE)
    await shared(anna, "save", content=OTHER, version=1)
    late = (await shared(alfred, "save", content=NOTE, version=1))["error"]
    assert (late["code"], late["details"]) == ("precondition_failed", {"version": 2, "by": "anna"})
    assert "anna" in late["message"]
    assert "another name" in late["remedy"]
    again = (await shared(alfred, "remove", version=1))["error"]
    assert again["code"] == "precondition_failed"
    found = (await own(alfred, "open", tenant="alpha"))["body"]
    assert (found["content"], found["version"], found["by"]) == (OTHER, 2, "anna")


async def test_who_takes_a_name_that_is_taken_is_told_so(site: Served) -> None:
    alfred = site.client(ALPHA)
    await own(alfred, "save", content=NOTE)
    assert (await own(alfred, "save", content=OTHER))["error"]["details"]["version"] == 1
    await own(alfred, "remove", version=1)
    gone = (await own(alfred, "save", content=OTHER, version=1))["error"]
    assert (gone["code"], gone["details"]) == ("precondition_failed", {"version": 0})


async def test_each_user_has_layouts_of_one_name_that_nobody_else_sees(site: Served) -> None:
    alfred, anna, admin = site.client(ALPHA), site.client(ALSO), site.client(ADMIN)
    await own(alfred, "save", content=NOTE)
    await own(anna, "save", content=OTHER)
    assert (await own(alfred, "open"))["body"]["content"] == NOTE
    assert await names(admin, OWN) == []
    assert (await own(admin, "open"))["error"]["code"] == "unknown_path"


async def test_a_tenant_shares_layouts_and_no_other_tenant_learns_of_them(site: Served) -> None:
    alfred, lena, berta = site.client(ALPHA), site.client(LOOKS), site.client(BETA)
    await shared(alfred, "save", content=NOTE)
    assert await names(lena, SHARED) == ["main"]
    assert (await own(lena, "open", tenant="alpha"))["body"]["content"] == NOTE
    assert await names(berta, SHARED) == []
    hidden = await own(berta, "open", tenant="alpha")
    nothing = await own(berta, "open", tenant="gamma")
    assert hidden["error"]["code"] == nothing["error"]["code"] == "unknown_path"


async def test_only_who_may_share_changes_what_is_shared(site: Served) -> None:
    lena, alfred, mixed = site.client(LOOKS), site.client(ALPHA), site.client(MIXED)
    assert (await own(lena, "save", content=NOTE))["status"] == "completed"
    assert (await shared(lena, "save", content=NOTE))["error"]["code"] == "forbidden"
    for client, tenant in ((alfred, "beta"), (alfred, "*"), (mixed, "beta")):
        refused = await shared(client, "save", content=NOTE, tenant=tenant)
        assert refused["error"]["code"] == "forbidden", tenant
    admin = site.client(ADMIN)
    assert (await shared(admin, "save", content=NOTE, tenant="*"))["status"] == "completed"
    assert await names(site.client(BETA), SHARED) == ["main"]


async def test_without_the_right_there_are_no_layouts(site: Served) -> None:
    blind = site.client(BLIND)
    assert (await own(blind, "save", content=NOTE))["error"]["code"] == "unknown_path"


async def test_who_proves_nothing_keeps_nothing() -> None:
    config = CONFIG + table("anonymous", role="viewer")
    async with served(config) as site:
        refused = (await own(site.client(None), "save", content=NOTE))["error"]
        assert refused["code"] == "forbidden"
        assert "Log in" in refused["remedy"]


async def test_a_dry_run_checks_and_keeps_nothing(site: Served) -> None:
    alfred = site.client(ALPHA)
    body = {"do": "save", "name": "main", "content": NOTE}
    assert (await alfred.request("execute", OWN, body=body, dry_run=True))["status"] == "completed"
    assert await names(alfred, OWN) == []
    missing = await alfred.request("execute", OWN, body=body | {"version": 3}, dry_run=True)
    assert missing["error"]["code"] == "precondition_failed"


async def test_what_is_no_layout_is_refused(site: Served) -> None:
    alfred = site.client(ALPHA)
    for body in (
        {"name": "main"},
        {"do": "save", "name": "main"},
        {"do": "save", "name": "main", "content": []},
        {"do": "save", "name": "a/b", "content": {}},
        {"do": "save", "name": "", "content": {}},
        {"do": "save", "name": "main", "content": {}, "tenant": "alpha"},
    ):
        refused = await alfred.request("execute", OWN, body=body)
        assert refused["error"]["code"] == "invalid_value", body
    assert await names(alfred, OWN) == []


async def test_their_size_and_number_are_limited() -> None:
    config = CONFIG + table("features.layouts", most=3, of_one=2, size=1024)
    async with served(config) as site:
        alfred, anna = site.client(ALPHA), site.client(ALSO)
        large = (await own(alfred, "save", content={"text": "x" * 1024}))["error"]
        assert (large["code"], large["details"]) == ("payload_too_large", {"limit": 1024})
        for name in "ab":
            await own(alfred, "save", name, content=NOTE)
        assert (await own(alfred, "save", "c", content=NOTE))["error"]["code"] == "queue_full"
        assert (await own(alfred, "save", "b", content=OTHER, version=1))["status"] == "completed"
        await own(anna, "save", content=NOTE)
        full = (await own(anna, "save", "b", content=NOTE))["error"]
        assert full["code"] == "queue_full"
        assert "administrator" in full["remedy"]


async def test_one_tenant_leaves_the_room_of_the_others(tmp_path: Path) -> None:
    config = CONFIG + table("features.layouts", most=2, of_one=2)
    config += table("store", path=f"{tmp_path}/store.db")
    async with served(config) as site:
        alfred, berta, admin = site.client(ALPHA), site.client(BETA), site.client(ADMIN)
        await own(alfred, "save", content=NOTE)
        await shared(alfred, "save", content=NOTE)  # both count for alpha
        for full in (
            await own(site.client(ALSO), "save", content=NOTE),
            await shared(alfred, "save", "b", content=NOTE),
            await shared(admin, "save", "b", content=NOTE, tenant="alpha"),
        ):
            assert full["error"]["code"] == "queue_full"
            assert "2 layouts of alpha" in full["error"]["message"]
        for saved in (
            await own(berta, "save", content=NOTE),
            await shared(berta, "save", content=NOTE),
            await shared(admin, "save", content=NOTE, tenant="*"),
        ):
            assert saved["status"] == "completed"
    async with served(config) as site:  # they count for the same tenants after a restart
        alfred, berta = site.client(ALPHA), site.client(BETA)
        full = await own(berta, "save", "b", content=NOTE)
        assert "2 layouts of beta" in full["error"]["message"]
        await own(alfred, "remove", version=1)
        assert (await own(site.client(ALSO), "save", content=NOTE))["status"] == "completed"


async def test_layouts_outlive_a_restart(tmp_path: Path) -> None:
    config = CONFIG + table("store", path=f"{tmp_path}/store.db")
    async with served(config) as first:
        await own(first.client(ALPHA), "save", content=NOTE)
        await own(first.client(ALPHA), "save", "gone", content=NOTE)
        await own(first.client(ALPHA), "remove", "gone", version=1)
        await shared(first.client(ALPHA), "save", content=OTHER)
    async with served(config) as second:
        alfred = second.client(ALPHA)
        assert await names(alfred, OWN) == ["main"]
        assert (await own(alfred, "open"))["body"]["content"] == NOTE
        assert (await own(alfred, "open", tenant="alpha"))["body"]["version"] == 1
        assert (await own(second.client(ALSO), "open"))["error"]["code"] == "unknown_path"


async def test_layouts_of_a_gateway_before_this_one_are_read(tmp_path: Path) -> None:
    """Their rows do not tell in which tenant a user saved them."""
    store = tmp_path / "store.db"
    config = CONFIG + table("features.layouts", most=1) + table("store", path=str(store))
    async with served(config) as first:
        await own(first.client(ALPHA), "save", content=NOTE)
        await shared(first.client(BETA), "save", content=OTHER)
    with closing(sqlite3.connect(store)) as base, base:
        found = base.execute("SELECT key, value FROM kept WHERE place LIKE 'layouts.%'").fetchall()
        for key_, value in found:
            row = msgspec.msgpack.decode(value)
            assert row.pop("tenant")
            base.execute(
                "UPDATE kept SET value = ? WHERE key = ?", (msgspec.msgpack.encode(row), key_)
            )
    assert len(found) == 2
    async with served(config) as second:
        alfred, berta = second.client(ALPHA), second.client(BETA)
        assert (await own(alfred, "open"))["body"]["content"] == NOTE
        assert (await own(alfred, "save", content=OTHER, version=1))["status"] == "completed"
        assert (await own(second.client(ALSO), "save", content=NOTE))["status"] == "completed"
        full = await own(berta, "save", content=NOTE)  # what beta shares counts for beta
        assert "1 layouts of beta" in full["error"]["message"]


class TestLayouts(FeatureSuite):
    """What every feature keeps."""

    kind = KIND

    @pytest.mark.xfail(reason="the built-in viewer may see layouts", strict=True)
    async def test_nothing_of_it_is_seen_without_a_right(self, gateway: FeatureGateway) -> None:
        await super().test_nothing_of_it_is_seen_without_a_right(gateway)


async def test_no_version_comes_twice_so_that_no_save_undoes_a_new_layout_of_an_old_name(
    tmp_path: Path,
) -> None:
    config = CONFIG + table("store", path=f"{tmp_path}/store.db")
    async with served(config) as site:
        alfred, anna = site.client(ALPHA), site.client(ALSO)
        await shared(alfred, "save", content=NOTE)
        await shared(anna, "remove", version=1)
        made = (await shared(anna, "save", content=OTHER))["body"]
        late = (await shared(alfred, "save", content=NOTE, version=1))["error"]
        assert (late["code"], late["details"]["by"]) == ("precondition_failed", "anna")
        await shared(anna, "remove", version=made["version"])
    async with served(config) as site:
        again = (await shared(site.client(ALSO), "save", content=OTHER))["body"]
        assert again["version"] > made["version"]
