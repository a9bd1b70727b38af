"""Links with certificates: who may join, and what each may say, over real TLS and QUIC."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

pytest.importorskip("zenoh")

from backends.fleet.rig import appears, free_port, hub_at, robot_at
from certs import Authority, Signed
from rcp_fleet.access import access_rules
from rcp_kernel.app.server import prepare
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError, NotReady
from rcp_kernel.testing import OPERATOR, Served, eventually, serve
from rcp_zenoh.session import configuration, on_loop, opened
from rcp_zenoh.tls import TlsConfig

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
    return _secured(hub_at(port), tls, scheme, f"robots = {robots}\n")


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
    ("wrong", "record"),
    [
        ("another CA", "invalid peer certificate: UnknownIssuer"),
        ("expired", "invalid peer certificate: certificate expired"),
        ("no certificate", "peer sent no certificates"),
    ],
)
async def test_a_wrong_certificate_does_not_get_in_and_is_on_record(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], wrong: str, record: str
) -> None:
    authority, port = Authority(tmp_path), free_port()
    signed = {
        "another CA": lambda: Authority(tmp_path, "Other CA").sign("r7"),
        "expired": lambda: authority.sign("r7", days=(-2, -1)),
        "no certificate": lambda: authority.sign("r7"),
    }[wrong]()
    config = configuration(
        "client", connect=[f"tls/127.0.0.1:{port}"], tls=_files(authority, signed)
    )
    if wrong == "no certificate":
        for name in ("connect_certificate", "connect_private_key"):
            config.insert_json5(f"transport/link/tls/{name}", "null")
        config.insert_json5("transport/link/tls/enable_mtls", "false")
    async with _serving(_hub(port, authority, '["r7"]')):
        with pytest.raises(NotReady):
            async with opened(config, patient=False):
                pass
        told: list[str] = []

        async def recorded() -> bool:
            told.append(capfd.readouterr().out)
            return record in "".join(told)

        await eventually(recorded, f"{record!r} is said", _BOUND)


async def test_one_robot_cannot_speak_as_another_nor_hear_it(tmp_path: Path) -> None:
    authority, port = Authority(tmp_path), free_port()
    endpoint, loop = f"tls/127.0.0.1:{port}", asyncio.get_running_loop()
    router = configuration(
        "router",
        listen=[endpoint],
        tls=_files(authority, authority.server()),
        access=access_rules("alpha", ["r7", "r8"], []),
    )
    heard: list[str] = []
    spied: list[str] = []
    thief = configuration("client", connect=[endpoint], tls=_files(authority, authority.sign("r8")))
    robot = configuration("client", connect=[endpoint], tls=_files(authority, authority.sign("r7")))
    async with (
        opened(router, patient=False) as hub,
        opened(robot, patient=False) as r7,
        opened(thief, patient=False) as r8,
    ):
        note = on_loop(loop, lambda sample: heard.append(str(sample.key_expr)))
        spy = on_loop(loop, lambda sample: spied.append(str(sample.key_expr)))
        own = on_loop(loop, lambda sample: spied.append(f"own {sample.key_expr}"))
        asked = on_loop(loop, lambda sample: heard.append(f"r7 {sample.key_expr}"))
        kept = [
            hub.declare_subscriber("rcp/alpha/*/out/**", note),
            hub.liveliness().declare_subscriber("rcp/alpha/*/alive", note),
            r7.declare_subscriber("rcp/alpha/r7/in/*/*", asked),
            r8.declare_subscriber("rcp/alpha/r7/in/*/*", spy),
            r8.declare_subscriber("rcp/alpha/r8/in/*/*", own),
            r8.liveliness().declare_token("rcp/alpha/r9/alive"),
            r8.liveliness().declare_token("rcp/alpha/r8/alive"),
        ]
        r8.put("rcp/alpha/r7/out/h1/link", b"forged")

        async def arrived() -> bool:
            hub.put("rcp/alpha/r7/in/h1/link", b"secret")
            hub.put("rcp/alpha/r8/in/h1/link", b"for r8")
            r8.put("rcp/alpha/r8/out/h1/link", b"its own")
            wanted = {
                "rcp/alpha/r8/out/h1/link",
                "rcp/alpha/r8/alive",
                "r7 rcp/alpha/r7/in/h1/link",
            }
            return wanted <= set(heard) and "own rcp/alpha/r8/in/h1/link" in spied

        await eventually(arrived, "what is allowed arrives", _BOUND)
        assert "rcp/alpha/r7/out/h1/link" not in heard
        assert "rcp/alpha/r9/alive" not in heard
        assert "rcp/alpha/r7/in/h1/link" not in spied
        for one in kept:
            one.undeclare()


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
