"""Faults of a hub's or a robot's configuration are one clear sentence of `rcpd check`."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

pytest.importorskip("zenoh")

from backends.fleet.rig import hub_at, robot_at
from certs import Authority, Signed
from hubkeys import HubKey
from rcp_gateway.testing import OPERATOR
from rcpd.cli import main

Change = Callable[[str, Path], str]


class _Files:
    """The files of a hub and of a robot, all good."""

    def __init__(self, folder: Path) -> None:
        self.authority = Authority(folder)
        self.key = folder / "hub.key"
        self.key.write_text(HubKey().private_pem)
        self.key.chmod(0o600)

    def _tls(self, signed: Signed) -> str:
        signed.key.chmod(0o600)
        files = f'certificate = "{signed.cert}", key = "{signed.key}"'
        return f'tls = {{ ca = "{self.authority.file}", {files} }}\n'

    def hub(self) -> str:
        key = f'key = "{self.key}"'
        text = hub_at(7447).replace("tcp/", "tls/").replace(f'token = "{OPERATOR}"', key)
        tls = self._tls(self.authority.server())
        return text.replace("\nhub = ", f'\n{tls}robots = ["r7"]\nhub = ', 1)

    def robot(self) -> str:
        tls = self._tls(self.authority.sign("r7"))
        text = robot_at(7447).replace("tcp/", "tls/")
        return text.replace("\ngateway = ", f"\n{tls}gateway = ", 1)


def _check(folder: Path, text: str) -> tuple[int, str]:
    file = folder / "rcp.toml"
    file.write_text(text)
    done = CliRunner().invoke(main, ["check", str(file)])
    return done.exit_code, done.output


def _swap(old: str, new: str) -> Change:
    def change(text: str, _folder: Path) -> str:
        assert old in text
        return text.replace(old, new)

    return change


def _without(start: str) -> Change:
    def change(text: str, _folder: Path) -> str:
        assert f"\n{start}" in text
        return "\n".join(line for line in text.split("\n") if not line.startswith(start))

    return change


def _file(name: str, content: str | None, mode: int = 0o600) -> Change:
    def change(text: str, folder: Path) -> str:
        file = folder / name
        if content is None:
            file.unlink()
        else:
            file.write_text(content)
            file.chmod(mode)
        return text

    return change


@pytest.mark.parametrize("whose", ["hub", "robot"])
def test_good_configurations_pass(tmp_path: Path, whose: str) -> None:
    files = _Files(tmp_path)
    assert _check(tmp_path, files.hub() if whose == "hub" else files.robot())[0] == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_file("hub.key", None), "`key` '{0}/hub.key' cannot be read: No such file"),
        (_file("hub.key", "nonsense"), "'{0}/hub.key' is not an Ed25519 private key"),
        (_file("hub.key", HubKey().private_pem, 0o644), "run `chmod 600 {0}/hub.key`"),
        (
            _without('key = "/'),
            "write either `key`, the file of this hub's private key, or `token`",
        ),
        (_without("listen = "), "no router: `listen` makes this hub one"),
        (_swap("tls/127.0.0.1:7447", "127.0.0.1:7447"), "'127.0.0.1:7447' is not an endpoint"),
        (_swap("tls/127.0.0.1:7447", "tls/127.0.0.1"), "write tls/HOST:PORT with a port"),
        (_swap("127.0.0.1:7447", "127.0.0.1:99999"), "with a port up to 65535"),
        (_swap("tls/", "tsl/"), "'tsl/127.0.0.1:7447' is not an endpoint"),
        (_swap("tls/", "tcp/"), "'tcp/127.0.0.1:7447' is not encrypted"),
        (_without("tls = "), "'tls/127.0.0.1:7447' needs `tls`"),
        (
            lambda text, folder: _without("tls = ")(text.replace("tls/", "tcp/"), folder),
            "`robots`, `hubs` and `routers` are the rules of a router with `listen` and `tls`",
        ),
        (_swap('hub = "h1"', 'hub = "h/1"'), "hub: 'h/1'"),
        (_swap('["r7"]', '["r 7"]'), "robots[0]: 'r 7'"),
    ],
)
def test_a_fault_of_a_hub(tmp_path: Path, change: Change, message: str) -> None:
    code, output = _check(tmp_path, change(_Files(tmp_path).hub(), tmp_path))
    assert code == 1, output
    assert re.search(rf"{tmp_path}/rcp.toml:\d+: \[backends.fleet(.tls)?\] ", output)
    assert message.format(tmp_path) in output
    assert "rcp.toml: 1 fault\n" in output


def test_files_of_tls_that_do_not_fit_together(tmp_path: Path) -> None:
    files = _Files(tmp_path)
    text = files.hub()
    signed = Authority(tmp_path, "Other CA").sign("other")
    own = text.partition('certificate = "')[2].partition('"')[0]
    code, output = _check(tmp_path, text.replace(own, str(signed.cert)))
    assert code == 1
    assert f"is not the key of the certificate '{signed.cert}'" in output
    code, output = _check(tmp_path, text.replace(str(files.authority.file), str(files.key)))
    assert code == 1
    assert f"`tls.ca` '{files.key}' has no certificate in PEM" in output
    Path(own).write_text("nonsense")
    code, output = _check(tmp_path, text)
    assert code == 1
    assert f"`tls.certificate` '{own}' has no certificate in PEM" in output


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_swap("tls/127", "tls:127"), "'tls:127.0.0.1:7447' is not an endpoint"),
        (_swap('gateway = "r7"', 'gateway = "r8"'), "is not that of the gateway 'r8'"),
    ],
)
def test_a_fault_of_a_robot(tmp_path: Path, change: Change, message: str) -> None:
    code, output = _check(tmp_path, change(_Files(tmp_path).robot(), tmp_path))
    assert code == 1, output
    assert re.search(rf"{tmp_path}/rcp.toml:\d+: \[transports.zenoh(.tls)?\] ", output)
    assert message in output
