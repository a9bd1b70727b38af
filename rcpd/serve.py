"""The gateway process: event loop, signals, exit code."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from typing import NoReturn

import click

from rcp_gateway.log import Recent, configure
from rcp_gateway.server import Prepared, Server, prepare, running
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.errors import StartupError
from rcp_kernel.features.configuration import SERVED_CONFIGURATION
from rcp_protocol.program import interrupt_ends
from rcpd.configuration_file import ConfigurationFile, run_again
from rcpd.demo import Demo
from rcpd.diagnosis import explained
from rcpd.exits import RECORD_LOST, fail
from rcpd.garbage import collected_at_rest
from rcpd.key_strength import log_weak_keys
from rcpd.memory import keep_freed_memory
from rcpd.notify import notifying
from rcpd.probation import Probation
from rcpd.process import end_in_time, run_contained
from rcpd.reload import reload
from rcpd.turns import take_short_turns

__all__ = ["leave", "loop_factory", "run"]

_CLOSE = 30.0  # s the gateway may take to close before a restart


def run(
    config: GatewayConfig, source: str, file: ConfigurationFile | None, demo: Demo | None
) -> None:
    """Serve a configuration until stopped, then exit.

    `file` is what SIGHUP reloads; `source` names the configuration in messages.
    """
    keep_freed_memory()
    take_short_turns()
    recent = configure(config.log.level, config.log.format)
    try:
        with interrupt_ends():  # a plugin that is imported could take Ctrl-C for its own fault
            prepared = prepare(config, source)
    except StartupError as error:
        fail(str(error) if file is None else explained(error, file.path))
    log_weak_keys(config.keys, source)
    with asyncio.Runner(loop_factory=loop_factory()) as runner:
        try:
            code = run_contained(runner, _serve(prepared, recent, file, demo))
            end_in_time(partial(leave, code, file))
        except StartupError as error:
            fail(str(error))
        except OSError as error:
            fail(f"cannot start: {error.strerror or error}")
        except BaseExceptionGroup as group:  # of a plugin that runs while the gateway starts
            found = _reason(group)
            if found is None:
                raise
            fail(str(found))
    sys.exit(code)


def _reason(group: BaseExceptionGroup[BaseException]) -> StartupError | None:
    """Return why the gateway could not start, if that is all that went wrong."""
    found, rest = group.split(StartupError)
    error: BaseException | None = found if rest is None else None
    while isinstance(error, BaseExceptionGroup):
        inner: tuple[BaseException, ...] = error.exceptions
        error = inner[0]
    return error if isinstance(error, StartupError) else None


def leave(code: int, file: ConfigurationFile | None) -> NoReturn:
    """End the process without waiting for its threads; start it again if that is due."""
    if file is not None and file.restarts:
        with suppress(OSError):
            run_again()
    os._exit(code)


def loop_factory() -> Callable[[], asyncio.AbstractEventLoop] | None:
    """Return uvloop's factory, if installed; None for that of asyncio."""
    try:
        import uvloop
    except ImportError:  # an extra
        return None
    return uvloop.new_event_loop


async def _serve(
    prepared: Prepared, recent: Recent, file: ConfigurationFile | None, demo: Demo | None
) -> int:
    """Serve until stopped; return the exit code."""
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    with notifying(loop) as notifier:

        def ask(name: str) -> None:
            restarts = file is not None and file.restarts
            if stop.is_set() and not restarts:
                click.echo("rcpd: stopped immediately", err=True)
                signal.raise_signal(signal.SIGKILL)
            click.echo(f"rcpd: {name}: stopping the robots", err=True)
            if file is not None:
                file.restarts = False
            notifier.send("STOPPING=1")
            stop.set()

        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, ask, number.name)
        async with running(prepared, recent) as server:
            notifier.send("READY=1")
            await _serve_until(stop, server, file, demo)
    if not server.gateway.store.lost:
        return 0
    click.echo("rcpd: cannot write the store: the last audit records are lost", err=True)
    return RECORD_LOST


async def _serve_until(
    stop: asyncio.Event, server: Server, file: ConfigurationFile | None, demo: Demo | None
) -> None:
    loop = asyncio.get_running_loop()
    tasks: set[asyncio.Task[bool]] = set()
    with ExitStack() as stack:
        if file is not None:

            def again() -> None:
                task = loop.create_task(reload(server, file.path), name="reload")
                tasks.add(task)
                task.add_done_callback(tasks.discard)

            loop.add_signal_handler(signal.SIGHUP, again)
            _watch_probation(stack, server, file, stop)
        click.echo(f"rcpd: event loop: {_loop_name(loop)}", err=True)
        stack.enter_context(collected_at_rest(loop, lambda: server.gateway.moving))
        if demo is not None:
            with demo.credentials(server):
                click.echo(demo.banner(server))
                await stop.wait()
        else:
            for facts in server.status.transports:
                if "url" in facts:
                    click.echo(f"rcpd: serving on {facts['url']}", err=True)
            await stop.wait()


def _loop_name(loop: asyncio.AbstractEventLoop) -> str:
    if type(loop).__module__.startswith("uvloop"):
        return "uvloop"
    faster = "" if sys.platform == "win32" else "; a faster one: pip install 'rcp-gateway[fast]'"
    return f"asyncio{faster}"


def _watch_probation(
    stack: ExitStack, server: Server, file: ConfigurationFile, stop: asyncio.Event
) -> None:
    def restart() -> None:
        click.echo("rcpd: restarting with another configuration", err=True)
        file.restart(_CLOSE)
        stop.set()

    probation = Probation(server, file, restart)
    stack.callback(probation.close)
    serve = server.client_api.service(SERVED_CONFIGURATION)
    if serve is not None:
        serve(probation)
