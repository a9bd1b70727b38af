"""A plugin that would end the process ends its own work; the process runs on, and ends in time."""

from __future__ import annotations

import asyncio
import importlib
import importlib.util
import os
import signal
import sys
import time
from pathlib import Path
from types import ModuleType

import pytest

from configuration import backend, listener, table
from rcp_gateway.hookspecs import hookimpl
from rcp_gateway.plugins import Plugins
from rcp_kernel.config.file import parse

pytestmark = pytest.mark.anyio
_TESTS = Path(__file__).parents[2]
_ENDS = 120.0  # s that a whole run may take on a busy machine
_STACKS = 10.0  # s that it has to say where it hangs
PLACES = [
    "open",
    "read",
    "write",
    "execute",
    "watch",
    "halt",
    "motion",
    "hold_stop",
    "close",
    "task",
    "timer",
    "call_soon",
    "publish",
]


async def run(*args: str) -> tuple[int | None, str, str, float]:
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "kernel.process.culprit",
        *args,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(_TESTS), "PYTHONFAULTHANDLER": "1"},
    )
    began = time.monotonic()
    talk = asyncio.ensure_future(process.communicate())
    try:
        if not (await asyncio.wait([talk], timeout=_ENDS))[0]:
            process.send_signal(signal.SIGABRT)
        async with asyncio.timeout(_STACKS):
            out, err = await talk
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    return process.returncode, out.decode(), err.decode(), time.monotonic() - began


@pytest.mark.parametrize("what", ["exit", "interrupt"])
@pytest.mark.parametrize("where", PLACES)
async def test_what_ends_a_process_ends_the_plugins_work_alone(where: str, what: str) -> None:
    code, out, err, _ = await run(where, what)
    lines = out.splitlines()
    assert len([line for line in lines if line.startswith("answered")]) == 6, out + err
    assert "other here" in lines
    assert lines[-1] == "closed", out + err
    assert code == 0, out + err


@pytest.mark.parametrize("where", ["thread", "executor"])
async def test_the_process_ends_though_a_plugin_left_a_thread_behind(where: str) -> None:
    code, out, err, took = await run(where, "exit")
    assert "closed\n" in out, out + err
    assert "threads_left_behind" in err + out, out + err
    assert code == 0, out + err
    assert took < _ENDS


def _plugin(name: str, **hooks: object) -> ModuleType:
    module = ModuleType(name)
    vars(module).update(hooks)
    return module


@pytest.mark.parametrize("error", [SystemExit(3), KeyboardInterrupt(), ZeroDivisionError()])
def test_a_plugin_whose_import_or_hook_would_end_the_process_is_missing(
    monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    real = importlib.import_module

    @hookimpl
    def rcp_adapters() -> object:
        raise error

    def load(name: str) -> ModuleType:
        if name == "rcp_sim":
            raise error
        return _plugin(name, rcp_adapters=rcp_adapters) if name == "rcp_a2a" else real(name)

    monkeypatch.setattr(importlib, "import_module", load)
    text = table("plugins.a2a") + table("plugins.mcp") + backend(use="sim")
    plugins = Plugins(parse(text, "test"))
    assert {(one.group, one.name) for one in plugins.missing} == {
        ("backends", "sim"),
        ("plugins", "a2a"),
    }
    assert "mcp" in plugins.adapters
    assert "asgi" in plugins.transports


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is None, reason="needs ROS 2")
async def test_a_ros_middleware_that_is_not_installed_fails_its_backend_alone(
    tmp_path: Path,
) -> None:
    file = tmp_path / "rcp.toml"
    file.write_text(listener() + backend("ros", use="ros2") + backend("rover", use="sim"))
    process = await asyncio.create_subprocess_exec(
        Path(sys.executable).with_name("rcpd"),
        "serve",
        file,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
        env={**os.environ, "RMW_IMPLEMENTATION": "rmw_nowhere_cpp"},
    )
    assert process.stdout is not None
    message = ""
    try:
        async with asyncio.timeout(_ENDS * 2):
            while "serving on" not in message or "cannot be loaded" not in message:
                line = await process.stdout.readline()
                assert line, message
                message += line.decode()
            assert "RMW_IMPLEMENTATION=rmw_nowhere_cpp" in message
            process.send_signal(signal.SIGTERM)
            await process.stdout.read()
            assert await process.wait() == 0
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
