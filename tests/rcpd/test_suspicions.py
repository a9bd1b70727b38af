"""`rcpd check` warns of what fits but is probably not meant, and reads files of any editor."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

from rcpd import suspicions
from rcpd.cli import main

SIM = '[[backends]]\nuse = "sim"\ntenant = "alpha"\n'
KEY = '[[keys]]\nname = "ann"\nrole = "operator"\n'
HASH = f'sha256 = "{"0" * 64}"\n'
MARK = "#!"
SUSPICIOUS = {
    "[transports.asgi]\nport = 80 #!\n": "CAP_NET_BIND_SERVICE",
    f'{KEY}key = "${{file:open.key}}" #!\n': "chmod 600 open.key",
    f'{KEY}{HASH}expires = "2020-01-31" #!\n': "in the past",
    f'{SIM}[plans.actions.go]\npath = "/tenant/alfa/action/go" #!\n': "did you mean 'alpha'",
    f'{SIM}[[roles.driver.allow]]\noperations = ["read"]\npaths = [\n"/tenant/alpha/**",\n'
    '"/tenant/beta/**", #!\n]\n': "no tenant 'beta'",
}


def checked(file: Path, *options: str) -> tuple[int, str]:
    done = CliRunner().invoke(main, ["check", *options, file.name])
    return done.exit_code, done.output


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "open.key").write_text("qL8x2VnC5bT7zR1yK4mW9sJ3\n")
    (tmp_path / "open.key").chmod(0o644)
    return tmp_path / "rcp.toml"


@pytest.mark.parametrize(("text", "says"), SUSPICIOUS.items(), ids=SUSPICIOUS.values())
def test_a_suspicion_is_a_warning_with_its_line(
    file: Path, monkeypatch: pytest.MonkeyPatch, text: str, says: str
) -> None:
    monkeypatch.setattr(suspicions, "_UNPRIVILEGED", Path("absent"))
    file.write_text(text)
    code, output = checked(file)
    (line,) = [i for i, one in enumerate(text.split("\n"), 1) if one.endswith(MARK)]
    (warning,) = [one for one in output.split("\n") if one.startswith("warning: ")]
    assert warning.startswith(f"warning: rcp.toml:{line}: ")
    assert says in warning
    assert code == 0


def test_a_store_that_this_user_cannot_write_is_a_warning(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda _, mode: mode != os.W_OK)
    file.write_text('[store]\npath = "absent/rcp.db"\n')
    code, output = checked(file)
    assert code == 0
    assert f"warning: rcp.toml:2: [store] path: '{file.parent}' cannot be written" in output


def test_a_file_of_windows_is_read(file: Path) -> None:
    file.write_bytes(b'\xef\xbb\xbf[log]\r\nlevel = "info"\r\n')
    assert checked(file)[0] == 0
    assert CliRunner().invoke(main, ["config", file.name]).exit_code == 0


@pytest.mark.parametrize(
    ("data", "line", "says"),
    [
        ('name = "a"\n'.encode("utf-16"), 1, "is UTF-16: save it as UTF-8"),
        (b'[log]\nlevel = "info"\n# M\xfcnchen\n', 3, "(byte 0xfc): save the file as UTF-8"),
    ],
)
def test_another_encoding_is_told_with_its_line(
    file: Path, data: bytes, line: int, says: str
) -> None:
    file.write_bytes(data)
    code, output = checked(file)
    assert code == 1
    assert f"rcp.toml:{line}: " in output
    assert says in output
    answer = msgspec.json.decode(checked(file, "--json")[1])
    assert [one["line"] for one in answer["faults"]] == [line]
    served = CliRunner().invoke(main, ["serve", file.name])
    assert says in served.output


@pytest.mark.parametrize("command", ["check", "config"])
def test_a_file_that_is_not_there_is_told(file: Path, command: str) -> None:
    done = CliRunner().invoke(main, [command, file.name])
    assert done.exit_code == 1
    assert "rcp.toml:1: cannot be read: No such file or directory; `rcpd init`" in done.output
