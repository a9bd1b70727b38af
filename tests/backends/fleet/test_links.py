"""Links with certificates: who may join, and what each may say, over real TLS and QUIC."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

from click.testing import CliRunner

from backends.fleet.rig import (
    appears,
    catalogue,
    hub_at,
    process_of,
    recorded,
    robot_at,
)
from certs import Authority, Signed
from configuration import key, table
from ports import free_port
from rcp_gateway.server import prepare
from rcp_gateway.testing import ADMIN, OPERATOR, Served, eventually, serve
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError, NotReady
from rcp_zenoh.session import configuration, on_loop, opened
from rcp_zenoh.tls import TlsConfig
from rcpd.audit import audit

pytestmark = pytest.mark.anyio
_POSE = "/tenant/alpha/sensor/r7/pose"
_BOUND = 60.0  # s, on any machine


def _files(authority: Authority, signed: Signed) -> TlsConfig:
    signed.key.chmod(0o600)
    return TlsConfig(ca=str(authority.file), certificate=str(signed.cert), key=str(signed.key))


def _table(head: str, tls: TlsConfig) -> str:
    return f'{head} = {{ ca = "{tls.ca}", certificate = "{tls.certificate}", key = "{tls.key}" }}\n'


def _secured(text: str, tls: TlsConfig, scheme: str, more: str = "") -> str:
    line = _table("tls", tls) + more
    text = text.replace("tcp/", f"{scheme}/")
    for first in ("hub = ", "gateway = "):
        text = text.replace(f"\n{first}", f"\n{line}{first}", 1)
    return text


def _hub(port: int, authority: Authority, robots: str, scheme: str = "tls") -> str:
    tls = _files(authority, authority.server())
    return _secured(hub_at(port) + key("admin", ADMIN), tls, scheme, f"robots = {robots}\n")


@asynccontextmanager
async def _serving(text: str) -> AsyncGenerator[Served]:
    async with serve(parse(text, "test")) as served:
        yield served


@pytest.mark.parametrize("scheme", ["tls", "quic"])
async def test_a_robot_with_its_certificate_is_served(tmp_path: Path, scheme: str) -> None:
    authority, port = Authority(tmp_path), free_port()
    robot = _secured(robot_at(port), _files(authority, authority.sign("r7")), scheme)
    async with _serving(_hub(port, authority, '["r7"]', scheme)) as hub, _serving(robot):
        client = hub.client(OPERATOR)
        await appears(client, _POSE)
        done = await client.request("write", "/tenant/alpha/param/r7/speed_limit", body=0.5)
        assert done["status"] == "completed", done
        id_ = await client.subscribe(_POSE)
        await client.update(id_)
        await client.close()


@pytest.mark.parametrize(
    ("scheme", "wrong", "said"),
    [
        ("tls", "another CA", "invalid peer certificate: UnknownIssuer"),
        ("quic", "another CA", "invalid peer certificate: UnknownIssuer"),
        ("tls", "expired", "invalid peer certificate: certificate expired"),
        ("tls", "no certificate", "peer sent no certificates"),
    ],
)
async def test_a_wrong_certificate_does_not_get_in_and_is_on_record(
    tmp_path: Path, scheme: str, wrong: str, said: str
) -> None:
    authority, port = Authority(tmp_path), free_port()
    signed = {
        "another CA": lambda: Authority(tmp_path, "Other CA").sign("r7"),
        "expired": lambda: authority.sign("r7", days=(-2, -1)),
        "no certificate": lambda: authority.sign("r7"),
    }[wrong]()
    config = configuration(
        "client", connect=[f"{scheme}/127.0.0.1:{port}"], tls=_files(authority, signed)
    )
    if wrong == "no certificate":
        for name in ("connect_certificate", "connect_private_key"):
            config.insert_json5(f"transport/link/tls/{name}", "null")
        config.insert_json5("transport/link/tls/enable_mtls", "false")
    async with _serving(_hub(port, authority, '["r7"]', scheme)) as hub:
        with pytest.raises(NotReady):
            async with opened(config, patient=False):
                pass
        record = await recorded(hub, lambda one: said in one.get("message", ""))
        assert record["what"] == "denial"
        assert record["outcome"] == "unauthenticated"
        assert record["tenant"] == "alpha"
        assert _refused(hub) == {"unauthenticated": 1}


def _denials(store: Path) -> list[dict[str, Any]]:
    arguments = ["export", "--store", str(store), "--what", "denial"]
    done = CliRunner().invoke(audit, arguments)
    assert done.exit_code == 0, done.output
    return [json.loads(line) for line in done.stdout.splitlines()]


def _refused(hub: Served) -> dict[str, int]:
    (supervisor,) = hub.server.supervisors
    return dict(supervisor.refusals)


async def test_a_certificate_of_an_unknown_robot_is_on_record_with_its_name(tmp_path: Path) -> None:
    authority, port = Authority(tmp_path), free_port()
    tls = _files(authority, authority.sign("r9"))
    config = configuration("client", connect=[f"tls/127.0.0.1:{port}"], tls=tls)
    async with (
        _serving(_hub(port, authority, '["r7"]')) as hub,
        opened(config, patient=False) as r9,
    ):
        token = r9.liveliness().declare_token("rcp/alpha/r9/alive")
        record = await recorded(hub, lambda one: "'r9'" in one.get("message", ""))
        assert record["outcome"] == "forbidden"
        assert "tls/127.0.0.1:" in record["message"]
        token.undeclare()


async def test_one_robot_cannot_speak_as_another_nor_hear_it_and_is_on_record(
    tmp_path: Path,
) -> None:
    authority, port = Authority(tmp_path), free_port()
    thief = configuration(
        "client",
        connect=[f"tls/127.0.0.1:{port}"],
        tls=_files(authority, authority.sign("r8")),
    )
    robot = _secured(robot_at(port), _files(authority, authority.sign("r7")), "tls")
    loop, heard, store = asyncio.get_running_loop(), list[str](), tmp_path / "hub.db"
    text = _hub(port, authority, '["r7", "r8"]') + table("store", path=str(store))
    async with (
        _serving(text) as hub,
        _serving(robot),
        opened(thief, patient=False) as r8,
    ):
        client = hub.client(OPERATOR)
        await appears(client, _POSE)
        assert _refused(hub) == {}  # what is allowed leaves no record
        spy = on_loop(loop, lambda sample: heard.append(str(sample.key_expr)))
        kept = [
            r8.declare_subscriber("rcp/alpha/r7/in/*/*", spy),
            r8.declare_subscriber("rcp/alpha/r8/in/*/*", spy),
            r8.liveliness().declare_token("rcp/alpha/r9/alive"),
            r8.liveliness().declare_token("rcp/alpha/r8/alive"),
        ]
        record = await recorded(hub, lambda one: one["what"] == "denial")
        assert record["outcome"] == "forbidden"
        assert "one of r7, r8" in record["message"]

        async def greeted() -> bool:
            await client.request("write", "/tenant/alpha/param/r7/speed_limit", body=0.5)
            return any("/r8/in/" in key for key in heard)

        await eventually(greeted, "the hub speaks to r8", _BOUND)
        assert not any("/r7/in/" in key for key in heard)
        assert not await catalogue(client, "/tenant/alpha/sensor/r9/**")

        many = 500
        before = sum(_refused(hub).values())
        for _ in range(many):
            r8.put("rcp/alpha/r7/out/h1/link", b"forged")

        async def counted() -> bool:
            return sum(_refused(hub).values()) >= before + many

        await eventually(counted, "each of them is counted", _BOUND)
        records = [one for one in _denials(store) if one["outcome"] == "forbidden"]
        assert len(records) < many / 20
        for one in kept:
            one.undeclare()
        await client.close()


async def test_a_forger_is_named_if_zenoh_writes_what_it_forbids(tmp_path: Path) -> None:
    authority, port = Authority(tmp_path), free_port()
    forged = "rcp/alpha/r7/out/h1/link"
    store = tmp_path / "hub.db"
    text = _hub(port, authority, '["r7", "r8"]') + table("store", path=str(store))
    thief = configuration(
        "client",
        connect=[f"tls/127.0.0.1:{port}"],
        tls=_files(authority, authority.sign("r8")),
    )
    environment = {"RUST_LOG": "zenoh::net::routing::interceptor=trace"}
    process = process_of(tmp_path / "hub.toml", text, environment)
    async with process, opened(thief, patient=True) as r8:

        async def named() -> bool:
            r8.put(forged, b"forged")
            said = f"the rules of the router forbid 'r8' to put on {forged}"
            return any(one["message"] == said for one in _denials(store))

        await eventually(named, "the record names r8", _BOUND)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("tls/", "tcp/"), "'tcp/127.0.0.1:7447' is not encrypted: write tls/… or quic/…"),
        (("r7.key", "none.key"), "No such file"),
        (("tls = {", "tsl = {"), "did you mean `tls`?"),
    ],
)
def test_bad_links_of_a_robot_are_one_clear_sentence(
    tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    authority = Authority(tmp_path)
    signed = authority.sign("r7")
    text = _secured(robot_at(7447), _files(authority, signed), "tls").replace(*change)
    with pytest.raises(ConfigError) as caught:
        prepare(parse(text, "robot.toml"), "robot.toml")
    assert message in str(caught.value)


def test_an_encrypted_link_needs_its_files() -> None:
    text = robot_at(7447).replace("tcp/", "quic/")
    with pytest.raises(ConfigError, match=r"'quic/127.0.0.1:7447' needs `tls`"):
        prepare(parse(text, "robot.toml"), "robot.toml")


def test_a_key_that_others_can_read_is_refused(tmp_path: Path) -> None:
    authority = Authority(tmp_path)
    signed = authority.sign("r7")
    text = _secured(robot_at(7447), _files(authority, signed), "tls")
    signed.key.chmod(0o644)
    with pytest.raises(ConfigError, match="chmod 600"):
        prepare(parse(text, "robot.toml"), "robot.toml")
