"""The feature `quotas`: on by default, left out, missing, and its keys where they are in the file."""

from __future__ import annotations

import pytest

import rcp_quotas
from configuration import configuration
from kernel.world import CONFIG, world_of
from offering import withhold
from plugins.quotas.home import SLOW, at_home
from rcp_gateway.server import Prepared, prepare
from rcp_gateway.testing import FeatureSuite
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError, PluginError

pytestmark = pytest.mark.anyio
(KIND,) = rcp_quotas.rcp_features()
QUIET = configuration()


class TestQuotas(FeatureSuite):
    kind = KIND


def checked(text: str) -> Prepared:
    """Read a configuration as the start does, and `rcpd check`."""
    return prepare(parse(text, "gateway.toml"), "gateway.toml")


async def test_without_the_feature_a_gateway_counts_nothing_and_keeps_its_own_limits() -> None:
    text = "[features]\nquotas = false\n[limits]\nsubscriptions = 1\n"
    async with world_of(CONFIG + text) as world:
        client = world.client()
        assert client.connection.session.account is None
        assert "quotas" not in (await client.ask(type="status"))["body"]
        first, second = [
            await client.ask(type="subscribe", id=id_, path="/sensor/level") for id_ in ("a", "b")
        ]
        assert first["status"] == "completed"
        assert second["error"]["code"] == "queue_full"
        stop = await client.ask(type="execute", path="/system/estop", body={})
        assert stop["body"]["active"]


@pytest.mark.parametrize(
    "table",
    [SLOW, "[quotas.principal]\nsessions = 1\n", "[roles.r.quota]\nplans = 1\n"],
)
def test_a_quota_is_not_ignored_because_the_feature_is_off_or_missing(
    monkeypatch: pytest.MonkeyPatch, table: str
) -> None:
    with pytest.raises(ConfigError, match="quotas = false, but the configuration uses"):
        parse(at_home(table + "[features]\nquotas = false\n"), "f")
    withhold(monkeypatch, "rcp.features", "quotas")
    checked(QUIET)
    with pytest.raises(PluginError, match="'quotas', which cannot be loaded: not installed"):
        checked(QUIET + table)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("[tenants.alpha.quota]\nrequest = 5", ["[tenants[...].quota]", "did you mean `requests`"]),
        ("[quotas.principal]\nsessions = 0", ["quotas.principal.sessions", ">= 1"]),
        ("[roles.r.quota]\nrequests = -1", ["roles", "quota.requests"]),
        ("[quotas]\ntenant = {}", ["[quotas]", "unknown key `tenant`"]),
    ],
)
def test_a_faulty_quota_is_named(table: str, words: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        checked(QUIET + table)
    for word in words:
        assert word in str(caught.value)
