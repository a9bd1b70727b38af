"""`rcpd`, the gateway: demo, serve, check, plugins, new, audit, token, version; and what plugins add."""

from __future__ import annotations

import asyncio
import signal
import sqlite3
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

from rcp_kernel.access.cli import token
from rcp_kernel.config.file import GatewayConfig, load, parse
from rcp_kernel.errors import ConfigError, StartupError
from rcp_kernel.record.cli import audit
from rcp_kernel.record.damage import find_damage
from rcp_kernel.record.store_cli import store

if TYPE_CHECKING:
    from rcp_kernel.app.server import Prepared, Server
    from rcp_kernel.process.demo import Demo
    from rcp_kernel.process.log import Recent

__all__ = ["main"]

_FAILED = 1
_RECORD_LOST = 3


class _Commands(click.Group):
    """The commands of the kernel, and those that plugins bring: entry points `rcp.commands`."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return every name."""
        return sorted({*super().list_commands(ctx), *_brought()})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command; a plugin is imported only for its own."""
        found = super().get_command(ctx, cmd_name)
        if found is None and (point := _brought().get(cmd_name)) is not None:
            found = point.load()
        return found


def _brought() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group="rcp.commands")}


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
def main() -> None:
    """Run and manage an RCP gateway: one server between robots and their clients."""


main.add_command(audit)
main.add_command(store)
main.add_command(token)


@main.command()
@click.option("--port", type=click.IntRange(0, 65535), default=8080, show_default=True)
@click.option("--verbose", is_flag=True, help="Log at level info, not only warnings.")
def demo(*, port: int, verbose: bool) -> None:
    """Serve simulated robots on loopback, without hardware or configuration."""
    from rcp_kernel.process.demo import Demo

    made = Demo(port)
    config = parse(made.config("info" if verbose else "warning"), "demo")
    _run(config, "demo", None, made)


@main.command()
@click.argument("config", type=click.Path(path_type=Path), default="rcp.toml")
def serve(config: Path) -> None:
    """Serve the robots of a configuration file (default: ./rcp.toml).

    SIGHUP reloads the file: roles, keys, certificates, limits and backends change at once;
    listeners need a restart. SIGTERM or Ctrl-C stops the robots and the gateway. Exit code: 0, 1
    if the gateway cannot start, 3 if the last audit records could not be written.
    """
    _run(_loaded(config), str(config), config, None)


@main.command()
@click.argument("config", type=click.Path(path_type=Path))
def check(config: Path) -> None:
    """Report every error of a configuration without opening a robot or a socket."""
    from rcp_kernel.access.identities import store_file
    from rcp_kernel.access.key_strength import weak_keys
    from rcp_kernel.app.server import prepare

    try:
        prepared = prepare(load(config), str(config))
    except StartupError as error:
        _fail(str(error))
    for missing in prepared.plugins.missing:
        click.echo(
            f"warning: {missing.group} '{missing.name}' cannot be imported: {missing.reason}; "
            f"try: {missing.remedy}",
            err=True,
        )
    _warn_of_damage(store_file(prepared.config))
    found = prepared.config
    for name in weak_keys(found.keys):
        click.echo(
            f"warning: key '{name}' is easy to guess: put the output of `openssl rand -hex 32` in its "
            f"place, or a token: `rcpd token create {name} --config {config} --role ROLE`",
            err=True,
        )
    robots = ", ".join(f"{b.name} ({b.use}, tenant {b.tenant})" for b in found.backends) or "none"
    click.echo(f"{config}: good")
    click.echo(f"  backends      {robots}")
    click.echo(f"  transports    {', '.join(found.transports) or 'none'}")
    click.echo(f"  plugins       {', '.join(found.plugins) or 'none'}")
    click.echo(f"  keys          {', '.join(key.name for key in found.keys) or 'none'}")
    named = dict.fromkeys(one.name for one in found.certificates)
    click.echo(f"  certificates  {', '.join(named) or 'none'}")
    click.echo(f"  issuers       {', '.join(one.issuer for one in found.jwt) or 'none'}")
    strangers = sorted({role for _, roles in found.anonymous.grants for role in roles})
    click.echo(f"  anonymous     {', '.join(strangers) or 'refused'}")
    if prepared.plugins.missing:
        sys.exit(_FAILED)


@main.command()
def plugins() -> None:
    """List the installed plugins, and what to install for those that cannot be used."""
    import importlib

    from rcp_kernel.plugins import GROUPS, installed, obstacle

    for group in GROUPS:
        for name, point in sorted(installed(group).items()):
            source = f"{point.dist.name} {point.dist.version}" if point.dist else "?"
            reason = obstacle(point)
            if reason is None:
                doc = importlib.import_module(point.value).__doc__ or ""
                text = doc.strip().partition("\n")[0]
            else:
                text = f"unavailable: {reason}"
            click.echo(f"{group:<11} {name:<10} {source:<20} {text}")


@main.group()
def new() -> None:
    """Generate the skeleton of a new plugin."""


@new.command("backend")
@click.argument("name")
@click.option(
    "--into",
    type=click.Path(path_type=Path),
    default=Path(),
    help="Parent folder. Default: the current folder.",
)
def new_backend(name: str, into: Path) -> None:
    """Generate a backend plugin with its own distribution that passes the public test suite."""
    from rcp_kernel.process.scaffold import write_backend

    try:
        made = write_backend(name, into)
    except StartupError as error:
        _fail(str(error))
    click.echo(f"Wrote {made}. Next:")
    click.echo(f"  pip install -e {made}[test]")
    click.echo(f"  pytest {made}")


@main.command()
def version() -> None:
    """Print the gateway's and the protocol's version."""
    from rcp_kernel.status import gateway_version
    from rcp_kernel.wire import VERSION

    click.echo(f"rcp-gateway {gateway_version()} (protocol RCP/{VERSION})")


def _warn_of_damage(path: Path | None) -> None:
    """Tell of a damaged store: the gateway starts with one, but not as its operator expects."""
    if path is None:
        return
    with suppress(sqlite3.Error, OSError):  # serving says what stands in the way
        damage = find_damage(path)
        if damage is not None:
            text = (
                f"the store is damaged: {damage}; every robot will be latched at the start. "
                "Run `rcpd store repair`"
            )
            click.echo(f"warning: {text}", err=True)


def _loaded(path: Path) -> GatewayConfig:
    try:
        return load(path)
    except ConfigError as error:
        _fail(str(error))


def _fail(text: str) -> NoReturn:
    click.echo(f"rcpd: {text}", err=True)
    sys.exit(_FAILED)


def _run(config: GatewayConfig, source: str, path: Path | None, demo: Demo | None) -> None:
    from rcp_kernel.access.key_strength import log_weak_keys
    from rcp_kernel.app.server import prepare
    from rcp_kernel.process.containment import end_in_time, run_contained
    from rcp_kernel.process.log import configure
    from rcp_kernel.process.memory import keep_freed_memory

    keep_freed_memory()
    recent = configure(config.log.level, config.log.format)
    try:
        prepared = prepare(config, source)
    except StartupError as error:
        _fail(str(error))
    log_weak_keys(config.keys, source)
    with asyncio.Runner(loop_factory=_loop_factory()) as runner:
        try:
            code = run_contained(runner, _serve(prepared, recent, path, demo))
            end_in_time(code)
        except StartupError as error:
            _fail(str(error))
        except OSError as error:
            _fail(f"cannot start: {error.strerror or error}")
    sys.exit(code)


def _loop_factory() -> Callable[[], asyncio.AbstractEventLoop] | None:
    try:
        import uvloop
    except ImportError:  # Windows has none
        return None
    return uvloop.new_event_loop


async def _serve(prepared: Prepared, recent: Recent, path: Path | None, demo: Demo | None) -> int:
    """Serve until told to stop; return the exit code."""
    from rcp_kernel.app.server import running
    from rcp_kernel.process.notify import notifying

    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    with notifying(loop) as notifier:

        def ask(name: str) -> None:
            if stop.is_set():
                click.echo("rcpd: stopped immediately", err=True)
                signal.raise_signal(signal.SIGKILL)
            click.echo(f"rcpd: {name}: stopping the robots", err=True)
            notifier.send("STOPPING=1")
            stop.set()

        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, ask, number.name)
        async with running(prepared, recent) as server:
            notifier.send("READY=1")
            await _serve_until(stop, server, path, demo)
    if not server.kernel.store.lost:
        return 0
    click.echo("rcpd: cannot write the store: the last audit records are lost", err=True)
    return _RECORD_LOST


async def _serve_until(
    stop: asyncio.Event, server: Server, path: Path | None, demo: Demo | None
) -> None:
    from rcp_kernel.app.reload import reload
    from rcp_kernel.process.garbage import collected_at_rest

    loop = asyncio.get_running_loop()
    tasks: set[asyncio.Task[None]] = set()
    if path is not None:

        def again() -> None:
            task = loop.create_task(reload(server, path), name="reload")
            tasks.add(task)
            task.add_done_callback(tasks.discard)

        loop.add_signal_handler(signal.SIGHUP, again)
    with collected_at_rest(loop, lambda: server.kernel.moving):
        if demo is not None:
            with demo.credentials(server):
                click.echo(demo.banner(server))
                await stop.wait()
        else:
            for facts in server.status.transports:
                if "url" in facts:
                    click.echo(f"rcpd: serving on {facts['url']}", err=True)
            await stop.wait()
