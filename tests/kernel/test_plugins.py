"""A plugin that breaks a rule is refused by name; one that cannot be imported stops nothing."""

from __future__ import annotations

import sys
import types
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import msgspec
import pluggy
import pytest

from rcp_kernel import hookspecs, plugins
from rcp_kernel.app.server import prepare, running
from rcp_kernel.config.file import parse
from rcp_kernel.errors import PluginError
from rcp_kernel.hookspecs import hookimpl
from rcp_kernel.spi import BackendKind

NO_TRANSPORTS = "transports = {asgi = false, http = false, ws = false, sse = false}\n"


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

    with pytest.raises(PluginError, match=r"backends\.some: the hook `rcp_backends` is async"):
        registered(module(rcp_backends=rcp_backends))


def test_a_misspelt_hook_is_refused_with_the_right_name() -> None:
    @hookimpl
    def rcp_backend() -> list[BackendKind]:
        return []

    with pytest.raises(PluginError, match="no hook `rcp_backend`; did you mean `rcp_backends`"):
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
    points = [EntryPoint(name, name, "rcp.backends") for name in sources]
    monkeypatch.setattr(
        plugins, "entry_points", lambda group: points if group == "rcp.backends" else []
    )


BACKEND = """
import msgspec
from rcp_kernel.hookspecs import hookimpl
from rcp_kernel.spi import BackendKind
class C(msgspec.Struct): pass
@hookimpl
def rcp_backends(): return [BackendKind("first", C, lambda config, host: None)]
"""


def configured(*names: str) -> str:
    tables = [f'[[backends]]\nuse = "{n}"\ntenant = "a"\n' for n in names]
    return NO_TRANSPORTS + "".join(tables)


def test_two_plugins_with_one_name_are_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    installed_as(monkeypatch, tmp_path, first=BACKEND, second=BACKEND)
    with pytest.raises(PluginError, match="two plugins offer the backend 'first'"):
        prepare(parse(configured("first", "second"), "f"), "f")


@pytest.mark.anyio
async def test_a_plugin_that_cannot_be_imported_is_unavailable_and_stops_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    installed_as(monkeypatch, tmp_path, ros2="import no_such_library")
    prepared = prepare(parse(configured("ros2"), "f"), "f")
    async with running(prepared) as server:
        backend = server.status.plain()["backends"][0]
        assert backend["state"] == "down"
        assert "no_such_library" in backend["detail"]
        assert "pip install 'rcp-gateway[ros2]'" in backend["detail"]
        ready, states = server.status.ready()
        assert (ready, states) == (False, {"ros2": "down"})


def test_nothing_runs_because_it_is_installed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    installed_as(monkeypatch, tmp_path, loud="raise SystemExit('imported')")
    prepare(parse(NO_TRANSPORTS, "f"), "f")


def test_an_interceptor_sees_every_request_and_may_refuse_it() -> None:
    seen: list[str] = []

    class Config(msgspec.Struct):
        pass

    def watch(handler: Any) -> Any:
        def handle(session: Any, request: Any, answer: Any) -> None:
            seen.append(request.type)
            handler(session, request, answer)

        return handle

    from kernel.world import CONFIG, prepared

    made = prepared(parse(CONFIG, "f"), [])
    made.plugins.interceptors.append(watch)

    import asyncio

    from kernel.world import Client

    async def run() -> None:
        async with running(made) as server:
            await Client(server.client_api).ask(type="ping")

    asyncio.run(run())
    assert seen == ["ping"]
