"""A plugin that breaks a rule is refused by name; one that cannot be imported stops nothing."""

from __future__ import annotations

import sys
import types
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pluggy
import pytest

from configuration import backend, configuration, table
from offering import offer
from rcp_gateway import hookspecs, plugins
from rcp_gateway.hookspecs import hookimpl
from rcp_gateway.server import prepare, running
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError, PluginError
from rcp_kernel.spi import BackendKind


def module(**members: Any) -> types.ModuleType:
    made = types.ModuleType("some_plugin")
    vars(made).update(members)
    return made


def registered(made: types.ModuleType) -> None:
    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    plugins.register(manager, made, "backends.some")


def test_an_async_hook_is_refused() -> None:
    @hookimpl
    async def rcp_backends() -> list[BackendKind]:
        return []

    with pytest.raises(
        PluginError,
        match=r"backends\.some: the hook `rcp_backends` must not "
        r"be async",
    ):
        registered(module(rcp_backends=rcp_backends))


def test_a_misspelt_hook_is_refused_with_the_right_name() -> None:
    @hookimpl
    def rcp_backend() -> list[BackendKind]:
        return []

    with pytest.raises(
        PluginError, match="unknown hook `rcp_backend`; did you mean `rcp_backends`"
    ):
        registered(module(rcp_backend=rcp_backend))


def test_a_module_without_hooks_is_refused() -> None:
    with pytest.raises(PluginError, match="no function marked @hookimpl"):
        registered(module())


def installed_as(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, **sources: str) -> None:
    """Make modules importable, each as a backend plugin of its own name."""
    for name, text in sources.items():
        (tmp_path / f"{name}.py").write_text(text)
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(str(tmp_path))
    offer(monkeypatch, [EntryPoint(name, name, "rcp.backends") for name in sources])


BACKEND = """
import msgspec
from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.spi import BackendKind
class C(msgspec.Struct): pass
@hookimpl
def rcp_backends(): return [BackendKind("first", C, lambda config, host: None)]
"""


def configured(*names: str) -> str:
    return configuration(*(backend(use=name) for name in names))


def test_two_plugins_with_one_name_are_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    installed_as(monkeypatch, tmp_path, first=BACKEND, second=BACKEND)
    with pytest.raises(PluginError, match="two plugins offer the backend 'first'"):
        prepare(parse(configured("first", "second"), "f"), "f")


def distributed(
    monkeypatch: pytest.MonkeyPatch, folder: Path, group: str, name: str, source: str, *extras: str
) -> None:
    """Install a distribution of one plugin, `robots-of-others`, with its metadata."""
    module = f"rcp_of_others_{name}"
    (folder / f"{module}.py").write_text(source)
    info = folder / "robots_of_others-1.dist-info"
    info.mkdir()
    offered = "".join(f"Provides-Extra: {extra}\n" for extra in extras)
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.3\nName: robots-of-others\nVersion: 1\n{offered}"
    )
    (info / "entry_points.txt").write_text(f"[rcp.{group}]\n{name} = {module}\n")
    monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.syspath_prepend(str(folder))


NEEDY = """
import msgspec
from rcp_gateway.hookspecs import hookimpl
from rcp_gateway.client_kinds import AdapterKind
from rcp_kernel.spi import BackendKind
class C(msgspec.Struct, forbid_unknown_fields=True): pass
def never(config, host): raise AssertionError("opened without what it needs")
needs = ("json", "no_such_library")
@hookimpl
def rcp_backends(): return [BackendKind("needy", C, never, needs=needs)]
@hookimpl
def rcp_adapters(): return [AdapterKind("needy", C, never, needs=needs)]
"""


@pytest.mark.anyio
@pytest.mark.parametrize("source", ["import no_such_library", NEEDY])
@pytest.mark.parametrize("extra", [True, False])
async def test_a_backend_whose_library_is_missing_says_what_to_install_and_stops_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, source: str, *, extra: bool
) -> None:
    distributed(monkeypatch, tmp_path, "backends", "needy", source, *["needy"] * extra)
    prepared = prepare(parse(configured("needy"), "f"), "f")
    async with running(prepared) as server:
        backend = server.status.plain()["backends"][0]
        assert backend["state"] == "down"
        assert "no_such_library" in backend["detail"]
        remedy = (
            "pip install 'robots-of-others[needy]'" if extra else "pip install robots-of-others"
        )
        assert backend["detail"].endswith(remedy)
        ready, states = server.status.ready()
        assert (ready, states) == (False, {"needy": "down"})


@pytest.mark.parametrize(
    "source",
    [
        "from rcp_kernel.spi import NoSuchThing",
        "import rcp_kernel.no_such_module",
        "from rcp_of_others_needy import no_such_name",
        "raise ImportError('not today')",
        "1 / 0",
    ],
)
def test_an_error_of_a_plugins_own_module_is_not_blamed_on_a_library(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, source: str
) -> None:
    distributed(monkeypatch, tmp_path, "backends", "needy", source, "needy")
    (missing,) = plugins.Plugins(parse(configured("needy"), "f")).missing
    advice = "fix its module rcp_of_others_needy, or remove 'needy' from the configuration"
    assert missing.remedy == advice


@pytest.mark.anyio
async def test_an_adapter_whose_library_is_missing_says_what_to_install_and_stops_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    distributed(monkeypatch, tmp_path, "plugins", "needy", NEEDY, "needy")
    prepared = prepare(parse(configuration(table("plugins.needy")), "f"), "f")
    async with running(prepared) as server:
        (adapter,) = (a for a in server.status.plain()["adapters"] if a["name"] == "needy")
    assert adapter["state"] == "down"
    detail = "No module named 'no_such_library'; pip install 'robots-of-others[needy]'"
    assert adapter["detail"] == detail


def test_the_table_of_a_backend_is_checked_without_its_library(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    distributed(monkeypatch, tmp_path, "backends", "needy", NEEDY, "needy")
    with pytest.raises(ConfigError, match="colour"):
        prepare(parse(configured("needy") + 'colour = "red"\n', "f"), "f")


def test_nothing_runs_because_it_is_installed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    installed_as(monkeypatch, tmp_path, loud="raise SystemExit('imported')")
    prepare(parse(configuration(), "f"), "f")
