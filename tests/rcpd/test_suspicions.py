"""`rcpd check` warns of what fits but is probably not meant, and reads files of any editor."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Generator, Iterator
from contextlib import contextmanager
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
SECRET = "qL8x2VnC5bT7zR1yK4mW9sJ3"
SUSPICIOUS = {
    "[transports.asgi]\nport = 80 #!\n": "CAP_NET_BIND_SERVICE",
    f'{KEY}key = "${{file:open.key}}" #!\n': "can read 'open.key': run `chmod o-r`",
    f'{KEY}{HASH}expires = "2020-01-31" #!\n': "in the past",
    f'{SIM}[plans.actions.go]\npath = "/tenant/alfa/action/go" #!\n': "did you mean 'alpha'",
    f'{SIM}[[roles.driver.allow]]\noperations = ["read"]\npaths = [\n"/tenant/alpha/**",\n'
    '"/tenant/beta/**", #!\n]\n': "no tenant 'beta'",
}


def checked(file: Path, *options: str) -> tuple[int, str]:
    done = CliRunner().invoke(main, ["check", *options, file.name])
    return done.exit_code, done.output


@pytest.fixture
def file(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with tempfile.TemporaryDirectory(dir="/tmp") as made:
        folder = Path(made)
        folder.chmod(0o755)
        monkeypatch.chdir(folder)
        (folder / "open.key").write_text(f"{SECRET}\n")
        (folder / "open.key").chmod(0o644)
        yield folder / "rcp.toml"
        monkeypatch.undo()


@contextmanager
def another_user() -> Generator[None]:
    """Look at files as a user of no group."""
    groups = os.getgroups()
    os.setgroups([])
    os.setegid(65534)
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)
        os.setegid(0)
        os.setgroups(groups)


def warnings(file: Path) -> list[str]:
    code, output = checked(file)
    assert code == 0, output
    return [one for one in output.split("\n") if one.startswith("warning: ")]


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


@pytest.mark.skipif(os.getuid() != 0, reason="only root can be another user")
@pytest.mark.parametrize("command", ["check", "config"])
def test_a_folder_that_may_not_be_searched_is_no_fault(file: Path, command: str) -> None:
    locked = file.parent / "locked"
    locked.mkdir(mode=0o750)
    file.write_text(f'[store]\npath = "{locked}/below/rcp.db"\n')
    assert CliRunner().invoke(main, [command, file.name]).exit_code == 0  # imports all it needs
    with another_user():
        done = CliRunner().invoke(main, [command, file.name])
    assert (done.exception, done.exit_code) == (None, 0), done.output
    assert "warning" not in done.output


@pytest.mark.skipif(os.getuid() != 0, reason="only root can be another user")
def test_an_included_file_that_may_not_be_seen_is_a_fault(file: Path) -> None:
    (file.parent / "locked").mkdir(mode=0o750)
    file.write_text('include = ["locked/robots.toml"]\n')
    checked(file)
    with another_user():
        code, output = checked(file)
    assert (code, "locked/robots.toml cannot be read: Permission denied" in output) == (1, True)


def test_a_folder_that_may_not_be_searched_has_no_warning(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda _, mode: mode == os.R_OK)
    file.write_text('[store]\npath = "absent/rcp.db"\n')
    assert warnings(file) == []


@pytest.mark.parametrize("day", ["2027-02-30", "soon", ""])
def test_a_day_that_is_none_hides_no_fault(file: Path, day: str) -> None:
    file.write_text(f'{KEY}{HASH}expires = "{day}"\n[log]\nlevel = "inof"\n')
    code, output = checked(file)
    assert code == 1
    assert "2 faults" in output
    assert "rcp.toml:5: [keys.ann] expires: " in output


def test_a_doubt_that_fails_hides_no_other(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise ArithmeticError

    monkeypatch.setattr(suspicions, "_is_open", fail)
    key = 'key = "${file:open.key}"\n'
    file.write_text(f'{KEY}{key}expires = "2020-01-31"\n')
    (warning,) = warnings(file)
    assert "in the past" in warning


def test_values_of_the_environment_and_of_files_are_in_no_warning(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WHERE", "/tenant/hush-hush/**")
    monkeypatch.setenv("WHO", "hush")
    monkeypatch.setenv("SECRETS", str(file.parent))
    monkeypatch.setenv("STORE", f"{file.parent}/hush/rcp.db")
    monkeypatch.setattr(os, "access", lambda _, mode: mode != os.W_OK)
    (file.parent / "path.txt").write_text("/tenant/whispered/x\n")
    (file.parent / "path.txt").chmod(0o600)
    file.write_text(
        '[tenants."alpha"]\n[[backends]]\nuse = "sim"\ntenant = "${WHO}"\n'
        '[[roles.driver.allow]]\noperations = ["read"]\n'
        'paths = ["${WHERE}", "${file:path.txt}", "/tenant/hushed/**"]\n'
        f'{KEY}key = "${{file:${{SECRETS}}/open.key}}"\n[store]\npath = "${{STORE}}"\n'
    )
    told = "\n".join(warnings(file))
    assert "no tenant 'hushed'; name one" in told
    assert "can read '${SECRETS}/open.key'" in told
    assert "cannot be written" in told
    assert "hush-hush" not in told
    assert "'hush'" not in told
    assert "whispered" not in told
    assert str(file.parent) not in told


def test_a_file_that_others_cannot_reach_is_not_open(file: Path) -> None:
    file.write_text(f'{KEY}key = "${{file:kept/link.key}}"\n')
    kept = file.parent / "kept"
    kept.mkdir()
    kept.chmod(0o750)
    (kept / "own.key").write_text(SECRET)
    (kept / "own.key").chmod(0o644)
    (kept / "link.key").symlink_to("own.key")
    assert warnings(file) == []
    (kept / "link.key").unlink()
    (kept / "link.key").symlink_to("../open.key")  # whoever knows its name can read that
    assert len(warnings(file)) == 1


def test_a_file_that_nobody_can_change_is_not_told_to_be(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file.write_text(f'{KEY}key = "${{file:open.key}}"\n')
    assert len(warnings(file)) == 1
    found = list(os.statvfs(file))
    found[8] |= os.ST_RDONLY
    monkeypatch.setattr(os, "statvfs", lambda _: os.statvfs_result(found))
    assert warnings(file) == []


def test_root_may_listen_on_any_port(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(suspicions, "_UNPRIVILEGED", Path("absent"))
    file.write_text("[transports.asgi]\nport = 80\n")
    assert len(warnings(file)) == 1
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert warnings(file) == []


def test_a_port_that_is_none_is_only_a_fault(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(suspicions, "_UNPRIVILEGED", Path("absent"))
    file.write_text("[transports.asgi]\nport = true\n")
    code, output = checked(file)
    assert (code, "only root" in output) == (1, False)


@pytest.mark.parametrize(("tenant", "told"), [("beta", 0), ("alfa", 1)])
def test_a_file_of_several_gateways_may_name_tenants_of_others(
    file: Path, tenant: str, told: int
) -> None:
    (file.parent / "roles.toml").write_text(
        f'[[roles.driver.allow]]\noperations = ["read"]\npaths = ["/tenant/{tenant}/**"]\n'
    )
    file.write_text(f'include = ["roles.toml"]\n{SIM}')
    assert len(warnings(file)) == told


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (f'{KEY}key = "${{file:a\\u0000b}}"\n', "embedded null byte"),
        (f'{KEY}key = "${{file:~nobody-of-this-name/b}}"\n', "cannot be read"),
        ('[store]\npath = "a\\u0000b"\n', "[store] path: contains a NUL"),
    ],
)
def test_a_path_that_none_can_be_is_a_fault(file: Path, text: str, says: str) -> None:
    file.write_text(text)
    code, output = checked(file)
    assert (code, "1 fault\n" in output) == (1, True), output
    assert says in output
