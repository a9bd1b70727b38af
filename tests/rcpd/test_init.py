"""`rcpd init` writes what can be served at once, and overwrites nothing without being told."""

from __future__ import annotations

import os
import pty
import shutil
import ssl
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner

import rcp_client
from rcpd.cli import main
from rcpd.diagnosis import Diagnosis
from rcpd.starter import ROBOTS
from serving import serving

NAMES = ["admin.key", "operator.key", "rcp-gateway.service", "rcp.toml"]


def init(folder: Path, *options: str, code: int = 0) -> str:
    done = CliRunner().invoke(main, ["init", "--into", str(folder), *options])
    assert done.exit_code == code, done.output
    return done.output


def files(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


async def test_a_robot_drives_with_what_was_written(tmp_path: Path) -> None:
    output = init(tmp_path, "--port", "1")
    file = tmp_path / "rcp.toml"
    text = file.read_text().replace("port = 1\n", "port = 0\n")
    assert f"rcpd serve {file}" in output
    with serving(file, text) as url:
        token = (tmp_path / "operator.key").read_text().strip()
        async with rcp_client.connect(url, token=token) as client:
            done = await client.execute("/action/move_to", {"position": {"x": 0.3, "y": 0.0}})
            assert done["distance"] > 0.2
            await client.estop(reason="a try")
        async with rcp_client.connect(url, token=(tmp_path / "admin.key").read_text().strip()) as c:
            await c.estop(reset=True)
    assert (tmp_path / "gateway.sqlite3").exists()


@pytest.mark.parametrize("use", ROBOTS)
def test_each_robot_is_a_good_configuration_that_only_its_owner_reads(
    tmp_path: Path, use: str
) -> None:
    init(tmp_path / "rcp", "--robot-kind", use)
    assert files(tmp_path / "rcp") == NAMES
    for path in (tmp_path / "rcp").iterdir():
        assert path.stat().st_mode & 0o077 == 0
    text = (tmp_path / "rcp" / "rcp.toml").read_text()
    found = [one for one in Diagnosis(text, "rcp.toml").findings if "import" not in one.message]
    assert found == []
    for name in ("operator", "admin"):
        assert (tmp_path / "rcp" / f"{name}.key").read_text().strip() not in text


def test_a_gateway_for_a_network_has_a_certificate_and_refuses_strangers(tmp_path: Path) -> None:
    output = init(tmp_path, "--host", "0.0.0.0", "--port", "8443")
    assert "https://127.0.0.1:8443" in output
    assert "RCP_CACERT" in output
    text = (tmp_path / "rcp.toml").read_text()
    assert tomllib.loads(text)["anonymous"] is False
    assert Diagnosis(text, "rcp.toml").prepared() is not None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(tmp_path / "tls/gateway.pem", tmp_path / "tls/gateway.key")
    assert (tmp_path / "tls/gateway.key").stat().st_mode & 0o077 == 0


def test_nothing_is_overwritten_without_being_told(tmp_path: Path) -> None:
    (tmp_path / "rcp.toml").write_text("mine")
    output = init(tmp_path, code=1)
    assert "already there, nothing was written" in output
    assert files(tmp_path) == ["rcp.toml"]
    init(tmp_path, "--force")
    assert files(tmp_path) == NAMES
    before = (tmp_path / "operator.key").read_text()
    init(tmp_path, "--force")
    assert (tmp_path / "operator.key").read_text() != before


def test_a_name_that_does_not_fit_is_told(tmp_path: Path) -> None:
    assert "letters, digits" in init(tmp_path, "--tenant", "a b", code=1)
    assert files(tmp_path) == []


def test_a_folder_that_cannot_be_written_is_named_with_what_to_do(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    output = init(file / "rcp", code=1)
    assert output == (
        f"rcpd: '{file}/rcp' cannot be written: Not a directory. "
        "Choose another folder with --into\n"
    )


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_nothing_is_written_for_a_user_who_does_not_exist(tmp_path: Path) -> None:
    assert "there is no user 'nobody-at-all'" in init(tmp_path, "--user", "nobody-at-all", code=1)
    assert files(tmp_path) == []


def test_on_a_terminal_it_asks_for_what_is_not_given(tmp_path: Path) -> None:
    master, slave = pty.openpty()
    command = [str(Path(sys.executable).with_name("rcpd")), "init", "--tenant", "yard"]
    with subprocess.Popen(
        command, stdin=slave, stdout=slave, stderr=slave, cwd=tmp_path
    ) as process:
        os.close(slave)
        os.write(master, b"nonsense\nsim\nrover\n\n\n9000\n")
        process.wait(60)
        os.close(master)
    config = tomllib.loads((tmp_path / "rcp.toml").read_text())
    assert config["transports"]["asgi"] == {"host": "127.0.0.1", "port": 9000}
    assert config["backends"] == [{"use": "sim", "name": "rover", "tenant": "yard"}]


def test_a_folder_that_a_configuration_cannot_name_is_refused(tmp_path: Path) -> None:
    output = init(tmp_path / "a $HOME", code=1)
    assert "--into" in output
    assert "dollar signs" in output
    assert not (tmp_path / "a $HOME").exists()


@pytest.mark.parametrize("name", ["rcp", "100 %d of it's"])
def test_the_unit_is_one_that_systemd_takes(tmp_path: Path, name: str) -> None:
    folder = tmp_path / name
    init(folder)
    unit = folder / "rcp-gateway.service"
    quoted = str(folder).replace("%", "%%")
    mark = '"' if " " in name else ""
    text = unit.read_text()
    assert f"rcpd serve {mark}{quoted}/rcp.toml{mark}\n" in text
    assert f"\nReadWritePaths={mark}-{quoted}{mark}\n" in text
    assert f"\nEnvironmentFile=-{quoted}/secrets.env\n" in text
    assert Diagnosis((folder / "rcp.toml").read_text(), "rcp.toml").prepared() is not None
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    done = subprocess.run(
        ["systemd-analyze", "verify", unit], capture_output=True, check=False, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--threshold=30", unit],
        capture_output=True,
        check=False,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stdout
