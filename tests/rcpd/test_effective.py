"""`rcpd config` prints a file that says the same, without its secrets."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner

from rcpd.cli import main
from rcpd.diagnosis import Diagnosis
from rcpd.effective import effective

TEXT = """
name = "a \\"quoted\\" name"

[[backends]]
use = "sim"
tenant = "alpha"

[transports]
sse = false

[features.frames.anchors]
"/tenant/alpha" = { latitude = 1.0, longitude = 2.0, altitude = 3.0 }

[plugins.dashboard]
[roles.driver]
allow = [{ operations = ["read"], paths = ["/**"] }]

[safety.groups]
cell = ["/tenant/alpha"]
"""


def printed(tmp_path: Path, text: str, code: int = 0) -> str:
    file = tmp_path / "rcp.toml"
    file.write_text(text)
    done = CliRunner().invoke(main, ["config", str(file)])
    assert done.exit_code == code, done.output
    return done.output


def test_it_is_a_file_that_says_the_same(tmp_path: Path) -> None:
    output = printed(tmp_path, TEXT)
    found = tomllib.loads(output)
    assert found["limits"]["deadline"] == 10.0
    assert found["transports"]["asgi"]["port"] == 8080
    assert found["transports"]["sse"] is False
    assert found["backends"][0]["rate"] > 0
    given, again = Diagnosis(TEXT, "a").prepared(), Diagnosis(output, "b").prepared()
    assert given is not None
    assert again is not None
    assert effective(again) == effective(given)


def test_no_secret_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RCP_SECRET", "0123456789-secret")
    keys = '[[keys]]\nname = "a"\nrole = "viewer"\nkey = "${RCP_SECRET}"\n'
    keys += '[[keys]]\nname = "b"\nrole = "viewer"\nkey = "another-long-secret"\n'
    output = printed(tmp_path, keys + '[tenants.t]\ndescription = "of ${RCP_SECRET}"\n')
    assert "secret" not in output
    assert output.count("…") == 3


def test_a_default_stands_for_a_variable_that_is_not_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("RCP_LEVEL", raising=False)
    text = '[log]\nlevel = "${RCP_LEVEL:-warning}"\n'
    assert tomllib.loads(printed(tmp_path, text))["log"]["level"] == "warning"
    monkeypatch.setenv("RCP_LEVEL", "")
    assert tomllib.loads(printed(tmp_path, text))["log"]["level"] == "warning"
    monkeypatch.setenv("RCP_LEVEL", "loud")
    assert ":2: [log] level: a value from the environment does not fit" in printed(
        tmp_path, text, code=1
    )
