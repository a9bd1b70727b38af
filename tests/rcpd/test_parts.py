"""Included files and secrets from files: what is in force, and faults with the file in which they are."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from click.testing import CliRunner

from rcp_kernel.config.file import load, parse
from rcp_kernel.errors import ConfigError
from rcpd.cli import main
from rcpd.diagnosis import Diagnosis

ROBOT = '[[backends]]\nuse = "sim"\nname = "{0}"\ntenant = "alpha"\n'
KEY = '[[keys]]\nname = "ann"\nrole = "operator"\nkey = "${file:ann.key}"\n'
SECRET = "a-long-key-in-a-file-1"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A file with two robots in included files, and a key whose secret is in a file beside it."""
    (tmp_path / "conf.d").mkdir()
    (tmp_path / "rcp.toml").write_text(
        'include = ["conf.d/*.toml", "keys/keys.toml"]\n[limits]\nbatch = 3\n' + ROBOT.format("a")
    )
    (tmp_path / "conf.d" / "1.toml").write_text(ROBOT.format("b") + "[limits]\npaths = 5\n")
    (tmp_path / "conf.d" / "2.toml").write_text(ROBOT.format("c"))
    (tmp_path / "keys").mkdir()
    (tmp_path / "keys" / "keys.toml").write_text(KEY)
    (tmp_path / "keys" / "ann.key").write_text(f"{SECRET}\n")
    return tmp_path


def faults(folder: Path) -> list[tuple[str, int, str]]:
    file = folder / "rcp.toml"
    found = Diagnosis(file.read_text(), str(file)).findings
    # Whatever `rcpd check` finds, the start refuses too.
    if found:
        with pytest.raises(ConfigError):
            load(file)
    return [
        (str(Path(one.file).relative_to(folder)) if one.file else "", one.line, one.message)
        for one in found
    ]


def test_tables_join_and_lists_are_appended(folder: Path) -> None:
    config = load(folder / "rcp.toml")
    assert [one.name for one in config.backends] == ["a", "b", "c"]
    assert (config.limits.batch, config.limits.paths) == (3, 5)
    assert config.keys[0].key == SECRET
    assert faults(folder) == []


def test_a_fault_has_the_file_and_line_in_which_it_is(folder: Path) -> None:
    (folder / "conf.d" / "2.toml").write_text("[log]\nlvl = 3\n" + ROBOT.format("b"))
    (folder / "rcp.toml").write_text((folder / "rcp.toml").read_text() + "rat = 3\n")
    assert [(file, line) for file, line, _ in faults(folder)] == [
        ("", 8),
        ("conf.d/2.toml", 2),
        ("conf.d/2.toml", 5),
    ]
    done = CliRunner().invoke(main, ["check", str(folder / "rcp.toml")])
    assert f"\n{folder}/conf.d/2.toml:5: [backends.b] name: two [[backends]]" in done.output


@pytest.mark.parametrize(
    ("name", "text", "file", "line", "says"),
    [
        ("conf.d/1.toml", "[limits]\nbatch = 4\n", "conf.d/1.toml", 2, "in another file too"),
        ("conf.d/1.toml", "\nx = = 3\n", "conf.d/1.toml", 2, "not TOML"),
        ("conf.d/1.toml", 'include = ["x"]\n', "", 1, "in the first one"),
        ("conf.d/1.toml", 'name = "${NOT_SET}"\n', "conf.d/1.toml", 1, "NOT_SET"),
        ("keys/keys.toml", KEY.replace("ann.key", "eve.key"), "keys/keys.toml", 4, "'eve.key'"),
        (
            "keys/keys.toml",
            KEY.replace("file:ann.key", "file:"),
            "keys/keys.toml",
            4,
            "${file:PATH}",
        ),
    ],
)
def test_what_is_wrong_with_a_part_is_told(
    folder: Path, name: str, text: str, file: str, line: int, says: str
) -> None:
    (folder / name).write_text(text)
    ((found, at, message),) = faults(folder)
    assert (found, at) == (file, line)
    assert says in message


def test_a_file_that_is_not_there_is_told(folder: Path) -> None:
    (folder / "keys" / "keys.toml").unlink()
    ((file, line, message),) = faults(folder)
    assert (file, line) == ("", 1)
    assert "keys.toml cannot be read" in message


def test_a_secret_from_a_file_is_not_shown(folder: Path) -> None:
    (folder / "keys" / "keys.toml").write_text(KEY + 'expires = "${file:ann.key}"\n')
    done = CliRunner().invoke(main, ["check", str(folder / "rcp.toml")])
    assert done.exit_code == 1
    assert SECRET not in done.output
    (folder / "keys" / "keys.toml").write_text(
        KEY + '[tenants.t]\ndescription = "${file:ann.key}"\n'
    )
    done = CliRunner().invoke(main, ["config", str(folder / "rcp.toml")])
    assert done.exit_code == 0
    assert SECRET not in done.output
    assert "ann" in done.output


def test_what_a_file_contains_is_taken_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path / "credentials"))
    (tmp_path / "credentials").mkdir()
    (tmp_path / "credentials" / "name").write_text("of ${HOME}\r\n")
    file = tmp_path / "rcp.toml"
    file.write_text('name = "a ${file:${CREDENTIALS_DIRECTORY}/name}"\n')
    assert load(file).name == "a of ${HOME}"


@pytest.mark.parametrize(
    "line",
    [
        'include = ["{pipe}"]',
        'name = "${{file:{pipe}}}"',
        'include = ["/**/*.toml"]',
        'include = ["conf**.toml"]',
        'include = ["~nobody-has-this-name/x"]',
        'name = "${{file:~nobody-has-this-name/x}}"',
        'include = ["a\\u0000b"]',
        'name = "${{file:a\\u0000b}}"',
    ],
)
def test_what_is_no_file_is_a_fault_at_once_and_no_traceback(tmp_path: Path, line: str) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    text = f'{line.format(pipe=pipe)}\n[[backends]]\nuse = "sim"\ntenant = "alpha"\n'
    with pytest.raises(ConfigError):
        parse(text, str(tmp_path / "rcp.toml"))
