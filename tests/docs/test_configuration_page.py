"""Every key of the configuration is told with its default, and no other; every example decodes."""

from __future__ import annotations

import re
import tomllib
from typing import Any

import msgspec
import pytest

from docs.pages import DOCS, ROOT, keys, rows, section
from rcp_a2a.config import Provider, PushConfig
from rcp_asgi.config import TlsConfig
from rcp_audit import AuditConfig
from rcp_dashboard import DashboardConfig
from rcp_gateway.plugins import Plugins
from rcp_hubs.config import HubConfig
from rcp_jwt.config import JwtConfig
from rcp_jwt.login_config import LoginConfig
from rcp_kernel.config.file import (
    Anonymous,
    BackendConfig,
    CertificateConfig,
    GatewayConfig,
    KeyConfig,
    Limits,
    LogConfig,
    StoreConfig,
    TenantConfig,
    parse,
)
from rcp_kernel.config.role import Role, Rule
from rcp_kernel.config.safety import Safety
from rcp_motion_limits import Bound, EnvelopeConfig, Fence
from rcp_plans.config import ActionTable, PlansConfig
from rcp_quotas import Quota

PAGE = DOCS / "configuration.md"
_NEEDED = object()
_TABLES = [
    ("Top level", GatewayConfig),
    ("`[tenants.<name>]`", TenantConfig),
    ("`[[backends]]`", BackendConfig),
    ("`[[certificates]]`", CertificateConfig),
    ("`[[keys]]`", KeyConfig),
    ("`[[jwt]]`", JwtConfig),
    ("`[jwt.login]`", LoginConfig),
    ("`[[hubs]]`", HubConfig),
    ("`[anonymous]`", Anonymous),
    ("Bounds", Bound),
    ("Fences", Fence),
    ("`[safety]`", Safety),
    ("`[limits]`", Limits),
    ("`[log]`", LogConfig),
    ("`[store]`", StoreConfig),
    ("`[audit]`", AuditConfig),
    ("`[plans.actions.<name>]`", ActionTable),
    ("`[plugins.dashboard]`", DashboardConfig),
]


def defaults(type_: Any) -> dict[str, Any]:
    """Return each key with its default as plain data."""
    found: dict[str, Any] = {}
    for field in msgspec.structs.fields(type_):
        value: Any = _NEEDED
        if field.default is not msgspec.NODEFAULT:
            value = msgspec.to_builtins(field.default)
        elif field.default_factory is not msgspec.NODEFAULT:
            value = msgspec.to_builtins(field.default_factory())
        found[field.encode_name] = list(value) if isinstance(value, tuple) else value
    return found


def told(text: str) -> dict[str, Any]:
    """Return each key of a table with the default that it gives, as far as it is a literal."""
    found: dict[str, Any] = {}
    for key, default, *_ in rows(text):
        code = re.fullmatch(r"`(.+)`", default)
        words = {"none": None, "*needed*": _NEEDED}
        value = tomllib.loads(f"x = {code[1]}")["x"] if code else words.get(default, ...)
        found[key.strip("`")] = value
    return found


def agree(text: str, type_: Any) -> None:
    """Compare a table with a type; a default in words (or none) is taken as it is."""
    real = {key: value for key, value in defaults(type_).items() if key != "options"}
    page = told(text)
    assert page.keys() == real.keys()
    assert {k: v for k, v in page.items() if v is not ...} == {
        k: v for k, v in real.items() if page[k] is not ...
    }


@pytest.mark.parametrize(("heading", "type_"), _TABLES, ids=str)
def test_a_table_of_the_kernel_is_told(heading: str, type_: Any) -> None:
    agree(section(PAGE, heading), type_)


def test_an_envelope_is_told() -> None:
    agree(section(PAGE, "`[[envelopes]]`").split("### Bounds")[0], EnvelopeConfig)


def test_plans_are_told() -> None:
    agree(section(PAGE, "`[plans]`").split("###")[0], PlansConfig)


def test_a_quota_is_told() -> None:
    agree(section(PAGE, "Quotas").split("A quota has")[1], Quota)


def test_a_role_and_its_rules_are_told() -> None:
    role, rule = section(PAGE, "`[roles.<name>]`").split("A rule has")
    agree(role, Role)
    agree(rule, Rule)


def house() -> Plugins:
    """Load every transport and backend of the house."""
    text = "".join(
        f'[[backends]]\nuse = "{name}"\ntenant = "t"\nname = "{name}"\n'
        for name in ("sim", "ros2", "can")
    )
    return Plugins(parse(text, "test"))


def test_every_transport_of_the_house_is_told() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for name, kind in house().transports.items():
        if defaults(kind.config):
            agree(section(PAGE, f"`[transports.{name}]`"), kind.config)
        else:
            assert f"`[transports.{name}]`" not in text


_ADAPTERS = "[plugins.a2a]\n[plugins.foxglove]\n[plugins.mcp]\n[plugins.rosbridge]\n"


def test_every_adapter_of_the_house_is_told() -> None:
    for name, kind in Plugins(parse(_ADAPTERS, "test")).adapters.items():
        agree(section(PAGE, f"`[plugins.{name}]`"), kind.config)


def test_tables_within_the_agent_are_told() -> None:
    agree(section(PAGE, "`[plugins.a2a.provider]`"), Provider)
    agree(section(PAGE, "`[plugins.a2a.push]`"), PushConfig)


def test_tls_is_told() -> None:
    agree(section(PAGE, "`[transports.asgi.tls]`"), TlsConfig)


def test_every_backend_of_the_house_tells_its_keys() -> None:
    for name, kind in house().backends.items():
        readme = ROOT / "backends" / f"rcp_{name}" / "README.md"
        documented = set(keys(section(readme, "Configuration")))  # and those of tables within
        assert set(defaults(kind.config)) - documented == set()


@pytest.mark.parametrize(
    "block",
    re.findall(r"^```toml\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL),
)
def test_a_block_of_the_page_is_a_configuration(block: str) -> None:
    parse(block, "configuration.md")
