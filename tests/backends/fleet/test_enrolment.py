"""Enrolment: a robot joins a fleet by a code that works once, for a while, and for a few attempts."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Generator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

pytest.importorskip("zenoh")

from backends.fleet.rig import appears, hub_at
from certs import Authority
from hubkeys import HubKey
from ports import free_port
from rcp_gateway.server import prepare
from rcp_gateway.testing import OPERATOR, serve
from rcp_hubs.cli import enroll
from rcp_hubs.enrolment import CertificateSigner, EnrolmentError, Identity, Invitation, enrol
from rcp_kernel.config.file import load, parse

pytestmark = pytest.mark.anyio
_BOUND = 60.0  # s, on any machine
_OFF = "[transports]\nasgi = false\nhttp = false\nws = false\nsse = false\n"
_ROBOT = f'{_OFF}[[backends]]\nuse = "sim"\nname = "rover"\ntenant = "alpha"\n'


@contextmanager
def _invited(tmp_path: Path, seconds: float = _BOUND) -> Generator[tuple[Invitation, list[str]]]:
    authority = Authority(tmp_path)
    signer = CertificateSigner(
        x509.load_pem_x509_certificate(authority.file.read_bytes()), authority.private
    )
    identity = Identity(configuration='x = "{folder}"\n', ca=authority.file.read_text())
    invitation = Invitation("r7", identity, signer, host="127.0.0.1")
    ends: list[str] = []

    def run() -> None:
        try:
            invitation.serve(seconds)
            ends.append("used")
        except EnrolmentError as error:
            ends.append(str(error))

    thread = threading.Thread(target=run)
    thread.start()
    yield invitation, ends
    thread.join(_BOUND)
    assert ends


def test_a_code_works_once(tmp_path: Path) -> None:
    with _invited(tmp_path) as (invitation, ends):
        tables = enrol("127.0.0.1", invitation.port, invitation.code, tmp_path / "fleet")
    assert ends == ["used"]
    assert tables == f'x = "{tmp_path / "fleet"}"\n'
    made = x509.load_pem_x509_certificate((tmp_path / "fleet" / "gateway.pem").read_bytes())
    assert made.subject.rfc4514_string() == "CN=r7"
    assert (tmp_path / "fleet" / "gateway.key").stat().st_mode & 0o777 == 0o600
    with pytest.raises(EnrolmentError, match="cannot be reached"):
        enrol("127.0.0.1", invitation.port, invitation.code, tmp_path / "again")


def test_wrong_codes_are_limited(tmp_path: Path) -> None:
    with _invited(tmp_path) as (invitation, ends):
        first = "b" if invitation.code[0] == "a" else "a"
        for _ in range(5):
            with pytest.raises(EnrolmentError, match="the code is wrong"):
                enrol("127.0.0.1", invitation.port, first + invitation.code[1:], tmp_path / "no")
    assert ends == ["5 wrong codes: make another invitation"]
    assert not (tmp_path / "no").exists()


def test_a_code_expires(tmp_path: Path) -> None:
    with _invited(tmp_path, 0.05) as (_, ends):
        pass
    assert ends == ["the code has expired"]


def test_someone_in_between_gets_no_secret(tmp_path: Path) -> None:
    with _invited(tmp_path) as (real, _):
        with (
            _invited(tmp_path, 1.0) as (other, ends),
            pytest.raises(EnrolmentError, match="someone is in between"),
        ):
            enrol("127.0.0.1", other.port, real.code, tmp_path / "no")
        assert ends == ["the code has expired"]
        with pytest.raises(EnrolmentError, match="not a whole code"):
            enrol("127.0.0.1", real.port, real.code[:-2], tmp_path / "no")
        with closing(socket.create_connection(("127.0.0.1", real.port))) as hostile:
            hostile.sendall(b"GET / HTTP/1.1\r\n\r\n")
        enrol("127.0.0.1", real.port, real.code, tmp_path / "fleet")


async def test_an_enrolled_robot_appears_at_its_hub(tmp_path: Path) -> None:
    authority, key, port, wait = Authority(tmp_path), HubKey(), free_port(), free_port()
    for name, text in (("hub.key", key.private_pem), ("ca.key", _secret(authority))):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o600)
    server = authority.server()
    server.key.chmod(0o600)
    tls = (
        f'tls = {{ ca = "{authority.file}", certificate = "{server.cert}", key = "{server.key}" }}'
    )
    more = f'key = "{tmp_path / "hub.key"}"\nrobots = ["r7"]\n{tls}'
    hub_text = hub_at(port).replace("tcp/", "tls/").replace(f'token = "{OPERATOR}"', more)
    hub_file, robot_file = tmp_path / "hub.toml", tmp_path / "robot.toml"
    hub_file.write_text(hub_text)
    robot_file.write_text(_ROBOT)
    process = _Invite(tmp_path, hub_file, authority.file, f"tls/127.0.0.1:{port}", wait)
    code = process.code()
    arguments = [f"127.0.0.1:{wait}", "--config", str(robot_file), "--code", code]
    done = CliRunner().invoke(enroll, [*arguments, "--folder", str(tmp_path / "fleet")])
    assert done.exit_code == 0, done.output
    process.end()
    again = CliRunner().invoke(enroll, arguments)
    assert "belongs to a fleet" in again.output
    prepare(load(robot_file), "robot.toml")
    async with serve(parse(hub_text, "test")) as hub, serve(load(robot_file)):
        ann = hub.client(OPERATOR)
        await appears(ann, "/tenant/alpha/sensor/r7/pose")
        limit = "/tenant/alpha/param/r7/speed_limit"
        assert (await ann.request("write", limit, body=0.5))["status"] == "completed"
        await ann.close()


class _Invite:
    """`rcpd fleet invite`, as a process of its own."""

    def __init__(self, folder: Path, hub: Path, ca: Path, router: str, port: int) -> None:
        program = "import sys; from rcp_hubs.cli import fleet; fleet(sys.argv[1:])"
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-u", "-c", program, "invite", "r7", "--config", str(hub)),
                *("--ca", str(ca), "--ca-key", str(folder / "ca.key"), "--role", "operator"),
                *("--connect", router, "--port", str(port)),
            ],
            stdout=subprocess.PIPE,
            text=True,
        )

    def code(self) -> str:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith("Code: "):
                return line.removeprefix("Code: ").strip()
        raise AssertionError("no code")

    def end(self) -> None:
        out, _ = self._process.communicate(timeout=_BOUND)
        assert "r7 is enrolled" in out
        assert self._process.returncode == 0


def _secret(authority: Authority) -> str:
    form = PrivateFormat.PKCS8
    return authority.private.private_bytes(Encoding.PEM, form, NoEncryption()).decode()
