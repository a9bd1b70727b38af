"""`rcpd token` makes keys, lists them and takes them back; a mistake is told with the way out."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from kernel.world import CONFIG
from rcpd.tokens import token


@pytest.fixture
def config(tmp_path: Path) -> Path:
    file = tmp_path / "rcp.toml"
    file.write_text(f'[store]\npath = "{tmp_path / "store.db"}"\n' + CONFIG)
    return file


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["create", "arm", "--role", "operatr"], "did you mean 'operator'?"),
        (["create", "arm", "--role", "viewer", "--tenant", "alpah"], "did you mean 'alpha'?"),
        (["create", "arm", "--grant", "alpha"], "write TENANT=ROLE"),
        (["create", "arm"], "--grant TENANT=ROLE"),
        (["create", "a b", "--role", "viewer"], "NAME must be"),
        (["create", "arm", "--role", "viewer", "--expires", "soon"], "is not a date or time"),
        (["create", "arm", "--role", "viewer", "--expires", "2020-01-01"], "is in the past"),
        (["revoke", "arm"], "no valid key is named 'arm'"),
    ],
)
def test_a_mistake_is_told_with_the_way_out(config: Path, words: list[str], said: str) -> None:
    done = CliRunner().invoke(token, [*words, "--config", str(config)])
    assert done.exit_code == 1
    assert said in done.output


def test_without_a_store_there_are_no_tokens(tmp_path: Path) -> None:
    file = tmp_path / "rcp.toml"
    file.write_text(CONFIG)
    done = CliRunner().invoke(token, ["list", "--config", str(file)])
    assert done.exit_code == 1
    assert "add [store] with a `path`" in done.output


def test_a_second_token_of_a_name_outlives_the_first(config: Path) -> None:
    run = CliRunner()
    for _ in range(2):
        made = run.invoke(token, ["create", "arm", "--role", "viewer", "--config", str(config)])
        assert made.exit_code == 0, made.output
    first, second = run.invoke(token, ["list", "--config", str(config)]).output.splitlines()
    done = run.invoke(token, ["revoke", first.split()[0], "--config", str(config)])
    assert done.exit_code == 0, done.output
    left = run.invoke(token, ["list", "--config", str(config)]).output.splitlines()
    assert left == [second]
    everything = run.invoke(token, ["list", "--all", "--config", str(config)]).output
    assert "revoked" in everything
