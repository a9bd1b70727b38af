"""The feature `jwt`: on by default, left out, missing, and reloaded into a gateway without issuers."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from configuration import configuration, key
from issuer import Issuer, who
from kernel.world import CONFIG, Client, prepared, world_of
from offering import withhold
from rcp_gateway import plugins
from rcp_gateway.reload import apply
from rcp_gateway.server import prepare, running
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError, PluginError, Unauthenticated

pytestmark = pytest.mark.anyio
QUIET = configuration()
KEY = key("me", "key-of-the-test-here", role="admin")
TABLE = '[[jwt]]\nissuer = "https://i"\naudience = "a"\nrole = "viewer"\ndiscovery = true\n'


@pytest.fixture
def not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    withhold(monkeypatch, "rcp.features", "jwt")


@pytest.fixture
def without_library(monkeypatch: pytest.MonkeyPatch) -> None:
    real = plugins.find_spec
    monkeypatch.setattr(plugins, "find_spec", lambda name: None if name == "jwt" else real(name))


async def test_an_issuer_that_a_reload_brings_is_the_first(issuer: Issuer) -> None:
    async with world_of(CONFIG) as world:
        with pytest.raises(Unauthenticated, match="unknown token"):
            await who(world, issuer.token())
        assert not world.server.client_api.issuers
        await apply(world.server, prepared(parse(CONFIG + issuer.table(), "test"), []))
        assert (await who(world, issuer.token())).name == "ann"
        assert world.server.client_api.issuers == [issuer.url]
        assert world.server.client_api.proofs.issuers == (issuer.url,)
        assert world.server.client_api.serves


@pytest.mark.parametrize("text", ["", "[features]\njwt = false\n"])
async def test_without_issuers_a_gateway_needs_only_its_keys(text: str) -> None:
    async with world_of(CONFIG + text) as world:
        assert world.server.client_api.authenticate("operator-operator").name == "operator"
        with pytest.raises(Unauthenticated, match="unknown token"):
            await who(world, "eyJ.e30.c2ln")


@pytest.mark.parametrize("lacking", ["not_installed", "without_library"])
async def test_a_gateway_without_the_feature_serves_its_keys(
    lacking: str, request: pytest.FixtureRequest
) -> None:
    request.getfixturevalue(lacking)
    async with running(prepare(parse(QUIET + KEY, "test"), "test")) as server:
        client = Client(server.client_api, "key-of-the-test-here")
        with pytest.raises(Unauthenticated, match="unknown token"):
            await server.client_api.identify("eyJ.e30.c2ln")
        assert (await client.ask(type="status"))["body"]["state"] == "ok"


@pytest.mark.parametrize(
    ("lacking", "reason"),
    [
        ("not_installed", "not installed; try: pip install rcp-gateway"),
        ("without_library", "No module named 'jwt'; try: pip install 'rcp-gateway[jwt]'"),
    ],
)
def test_issuers_without_the_feature_are_a_clear_error(
    lacking: str, reason: str, request: pytest.FixtureRequest
) -> None:
    request.getfixturevalue(lacking)
    message = f"uses the feature 'jwt', which cannot be loaded: {reason}"
    with pytest.raises(PluginError, match=re.escape(message)):
        prepare(parse(QUIET + TABLE, "test"), "test")


def test_issuers_without_the_feature_are_an_error_of_check(
    not_installed: None, tmp_path: Path
) -> None:
    from click.testing import CliRunner

    from rcpd.cli import main

    file = tmp_path / "rcp.toml"
    file.write_text(QUIET + TABLE)
    done = CliRunner().invoke(main, ["check", str(file)])
    assert done.exit_code == 1
    assert "uses the feature 'jwt'" in done.output


def test_a_feature_that_is_turned_off_and_used_is_an_error() -> None:
    with pytest.raises(ConfigError, match="jwt = false"):
        parse(QUIET + "[features]\njwt = false\n" + TABLE, "test")


def test_a_wrong_key_of_a_table_is_told_with_its_place() -> None:
    with pytest.raises(ConfigError, match=r"^test: \[jwt\[0\]\] has an unknown key `audiance`"):
        prepare(parse(QUIET + TABLE.replace("audience", "audiance"), "test"), "test")


def test_tables_are_told_with_their_place_as_ever() -> None:
    text = TABLE + 'algorithms = ["HS256"]\n'
    with pytest.raises(ConfigError, match=r"^test: jwt\[0\]\.algorithms\[0\] = .*'HS256'"):
        prepare(parse(QUIET + text, "test"), "test")


def test_a_kernel_without_issuers_imports_no_library_of_tokens() -> None:
    code = f"""
import sys
sys.modules["jwt"] = None
sys.modules["cryptography"] = None
import asyncio
from rcp_gateway.server import prepare, running
from rcp_kernel.config.file import parse
async def main():
    text = {QUIET + KEY!r}
    async with running(prepare(parse(text, "test"), "test")) as server:
        print(server.client_api.authenticate("key-of-the-test-here").name)
asyncio.run(main())
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )
    assert (done.returncode, done.stdout.split()[-1:]) == (0, ["me"]), done.stderr
