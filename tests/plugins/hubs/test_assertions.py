"""Assertions of hubs: who a robot's gateway takes them for, and which it refuses."""

from __future__ import annotations

import re
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest

from configuration import backend, configuration, key, table
from hubkeys import HubKey
from rcp_gateway.reload import apply
from rcp_gateway.server import prepare
from rcp_gateway.testing import ADMIN, BOUND, OPERATOR, MemoryClient, Served, serve
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError, Forbidden, RcpError, TokenExpired, Unauthenticated

pytest.importorskip("zenoh")
pytestmark = pytest.mark.anyio
_DEAD = "tcp/127.0.0.1:9"  # nobody routes here: assertions are tested without a link
_GATEWAY = configuration(
    table("transports.zenoh", gateway="r7", tenant="alpha", connect=[_DEAD]),
    backend("rover", use="sim"),
    backend("other", "beta", use="sim"),
    key("ann", OPERATOR, role="operator"),
    key("root", ADMIN, role="admin"),
)
_S = 1_000_000_000


@asynccontextmanager
async def _robot(*tables: str) -> AsyncGenerator[Served]:
    async with serve(parse(_GATEWAY + "".join(tables), "test")) as served:
        yield served


@asynccontextmanager
async def _client(served: Served, token: str) -> AsyncGenerator[MemoryClient]:
    client = served.client(token)
    try:
        yield client
    finally:
        await client.close()


async def test_a_person_acts_with_the_asserted_roles_in_the_gateways_tenant() -> None:
    hub = HubKey()
    async with _robot(hub.table()) as robot, _client(robot, hub.assertion()) as client:
        principal = client.connection.session.principal
        assert (principal.name, principal.proof, principal.via) == ("ann", "hub h1", "h1")
        assert principal.grants == (("alpha", ("operator",)),)
        done = await client.request("write", "/tenant/alpha/param/speed_limit", body=0.5)
        assert done["status"] == "completed", done
        other = await client.request("read", "/tenant/beta/sensor/pose")
        assert other["status"] == "rejected", other


async def test_hubs_of_the_same_people_assert_the_same_person() -> None:
    first, second = HubKey("h1"), HubKey("h2")
    people = 'people = "works"'
    tables = first.table(more=people), second.table(more=people)
    async with _robot(*tables) as robot:
        principals = [robot.server.client_api.authenticate(h.assertion()) for h in (first, second)]
    assert principals[0].identity == principals[1].identity == ("ann", "hub works")
    assert [one.via for one in principals] == ["h1", "h2"]


async def test_a_name_that_someone_else_vouches_for_is_another_person() -> None:
    hub = HubKey()
    async with _robot(hub.table()) as robot:
        asserted = hub.assertion(rcp_proof="jwt https://issuer.example")
        principal = robot.server.client_api.authenticate(asserted)
    assert principal.identity == ("ann", "hub h1 jwt https://issuer.example")


async def test_a_hub_may_always_look_for_itself() -> None:
    hub = HubKey()
    own = hub.assertion(sub="h1", rcp_proof="hub", rcp_roles=("hub",))
    async with _robot(hub.table()) as robot, _client(robot, own) as client:
        read = await client.request("read", "/tenant/alpha/sensor/pose")
        assert read["status"] == "completed", read
        write = await client.request("write", "/tenant/alpha/param/speed_limit", body=0.5)
        assert write["error"]["code"] == "forbidden", write


def _refused(robot: Served, token: str) -> RcpError:
    with pytest.raises(RcpError) as caught:
        robot.server.client_api.authenticate(token)
    return caught.value


_BAD: dict[str, tuple[dict[str, Any], type[RcpError], str]] = {
    "another gateway": ({"aud": "alpha/r8"}, Unauthenticated, "'alpha/r8', which is not this one"),
    "an unknown hub": ({"iss": "h9"}, Unauthenticated, "hub 'h9' is not known"),
    "a role it may not": ({"rcp_roles": ("admin", "operator")}, Forbidden, "the role admin for"),
    "the hub's own role": ({"rcp_roles": ("hub",)}, Forbidden, "the role hub for 'ann'"),
    "no role": ({"rcp_roles": ()}, Unauthenticated, "rcp_roles"),
    "too long": ({"exp": 3600}, Unauthenticated, "at most 60 s"),
    "expired": ({"iat": -3600, "exp": -3550}, TokenExpired, "expired \\d+ s ago"),
    "made in the future": (
        {"iat": 900, "exp": 950},
        Unauthenticated,
        "in the future",
    ),
}


@pytest.mark.parametrize("name", _BAD)
async def test_a_bad_assertion_is_refused(name: str) -> None:
    claims, error, text = _BAD[name]
    now = time.time_ns() // _S
    claims = {n: now + c if n in ("iat", "exp") else c for n, c in claims.items()}
    hub = HubKey()
    async with _robot(hub.table()) as robot:
        refusal = _refused(robot, hub.assertion(**claims))
        assert type(refusal) is error
        assert re.search(text, refusal.message), refusal.message


async def test_the_key_of_another_hub_proves_nothing() -> None:
    hub, thief = HubKey(), HubKey()
    async with _robot(hub.table()) as robot:
        assert "not signed with a key of its hub" in _refused(robot, thief.assertion()).message


async def test_an_assertion_is_accepted_once_also_after_a_restart(tmp_path: Path) -> None:
    hub = HubKey()
    token, store = hub.assertion(), f'[store]\npath = "{tmp_path / "robot.db"}"\n'
    async with _robot(store, hub.table()) as robot:
        robot.server.client_api.authenticate(token)
        assert "used before" in _refused(robot, token).message
    async with _robot(store, hub.table()) as robot:
        assert "used before" in _refused(robot, token).message


async def test_a_refusal_and_a_login_are_on_record_with_person_and_hub() -> None:
    hub = HubKey()
    async with (
        _robot(hub.table()) as robot,
        _client(robot, ADMIN) as admin,
        _client(robot, OPERATOR) as client,
    ):
        token = hub.assertion(rcp_roles=("admin",))
        reply = await client.request("hello", body={"token": token})
        assert reply["error"]["code"] == "forbidden", reply
        reply = await client.request("hello", body={"token": hub.assertion()})
        assert reply["status"] == "completed", reply

        id_ = await admin.subscribe("/system/audit", history=100)
        denied = "may not assert the role admin for 'ann'"
        await admin.until(lambda m: m.get("id") == id_ and denied in str(m.get("body")))
        came = await admin.until(lambda m: m.get("id") == id_ and "via" in m.get("body", {}))
        assert (came["body"]["principal"], came["body"]["via"]) == ("ann", "h1")


async def test_a_hub_that_leaves_the_configuration_loses_its_sessions_at_once() -> None:
    hub, other = HubKey("h1"), HubKey("h2")
    async with (
        _robot(hub.table(), other.table()) as robot,
        _client(robot, hub.assertion()) as gone,
        _client(robot, other.assertion()) as stays,
    ):
        config = parse(_GATEWAY + other.table(), "test")
        await apply(robot.server, prepare(config, "test"))
        ended = await gone.until(lambda m: m.get("error") is not None, BOUND)
        assert ended["error"]["code"] == "token_expired", ended
        assert (await stays.request("ping"))["status"] == "completed"


@pytest.mark.parametrize(
    ("table", "text"),
    [
        (HubKey().table().replace("public_key", "public_kay"), "did you mean `public_key`"),
        (HubKey().table('["oprator"]'), "unknown role 'oprator'; did you mean 'operator'?"),
        (HubKey().table(more='tenants = ["gamma"]'), "unknown tenant 'gamma'"),
        (HubKey().table() * 2, "two [[hubs]] tables have the id 'h1'"),
        (
            '[[hubs]]\nid = "h1"\nroles = ["viewer"]\npublic_key = "none.pem"',
            "'none.pem' cannot be",
        ),
        (
            f'[[hubs]]\nid = "h1"\nroles = ["viewer"]\npublic_key = """{HubKey().private_pem}"""',
            "it is a private key",
        ),
    ],
)
def test_a_bad_table_is_one_clear_sentence(table: str, text: str) -> None:
    with pytest.raises(ConfigError) as caught:
        prepare(parse(_GATEWAY + table, "robot.toml"), "robot.toml")
    assert text in str(caught.value)


def test_hubs_need_the_name_of_the_gateway() -> None:
    text = _GATEWAY.replace("[transports.zenoh]", "[transports.other]")
    config = parse(text + HubKey().table(), "robot.toml")
    config = msgspec.structs.replace(config, transports={})
    with pytest.raises(ConfigError, match=r"\[\[hubs\]\] needs \[transports.zenoh\]"):
        prepare(config, "robot.toml")
