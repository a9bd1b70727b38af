"""`rcpd`: demo, init, serve, check, plugins, profiles, new, audit, token, version, plugin commands."""

from __future__ import annotations

import shlex
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import click
import msgspec

from rcp_kernel.config.file import GatewayConfig, load, parse
from rcp_kernel.contract.version import gateway_version
from rcp_kernel.errors import ConfigError, StartupError
from rcp_kernel.wire import VERSION
from rcpd.audit import audit
from rcpd.check import check
from rcpd.diagnosis import explained
from rcpd.effective import config_command
from rcpd.exits import FAILED, fail
from rcpd.init import init
from rcpd.profiles import profiles
from rcpd.scaffold import KINDS, write_plugin
from rcpd.schema import schema
from rcpd.store import store
from rcpd.tokens import token

__all__ = ["main"]


class _Commands(click.Group):
    """The commands of the kernel and of plugins (entry points `rcp.commands`)."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return all names."""
        return sorted({*super().list_commands(ctx), *_brought()})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command; a plugin is imported only for its own command."""
        found = super().get_command(ctx, cmd_name)
        if found is None and (point := _brought().get(cmd_name)) is not None:
            found = point.load()
        return found


def _brought() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group="rcp.commands")}


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(
    f"{gateway_version()} (protocol RCP/{VERSION})",
    prog_name="rcp-gateway",
    message="%(prog)s %(version)s",
)
def main() -> None:
    """Run and manage an RCP gateway: one server between robots and their clients."""


main.add_command(audit)
main.add_command(check)
main.add_command(config_command)
main.add_command(init)
main.add_command(profiles)
main.add_command(schema)
main.add_command(store)
main.add_command(token)


@main.command()
@click.option("--port", type=click.IntRange(0, 65535), default=8080, show_default=True)
@click.option("--verbose", is_flag=True, help="Log at level info, not only warnings.")
def demo(*, port: int, verbose: bool) -> None:
    """Serve simulated robots on loopback, without hardware or configuration."""
    from rcpd.demo import Demo
    from rcpd.serve import run

    made = Demo(port)
    config = parse(made.config("info" if verbose else "warning"), "demo")
    run(config, "demo", None, made)


@main.command()
@click.argument("config", type=click.Path(path_type=Path), default="rcp.toml")
@click.option("--host", help="Address to listen on, instead of that of [transports.asgi].")
@click.option(
    "--port", type=click.IntRange(0, 65535), help="Port to listen on, instead of that of the file."
)
def serve(config: Path, *, host: str | None, port: int | None) -> None:
    """Serve the robots of a configuration file (default: ./rcp.toml).

    SIGHUP reloads the file: roles, keys, certificates, limits and backends change at once;
    listeners need a restart. SIGTERM or Ctrl-C stops the robots and the gateway. Exit code: 0, 1
    if the gateway cannot start, 3 if the last audit records could not be written.
    """
    from rcpd.configuration_file import ConfigurationFile, run_again
    from rcpd.serve import run

    file = ConfigurationFile(config)
    file.start()
    try:
        run(_listening(_loaded(config), host, port), str(config), file, None)
    except (SystemExit, Exception) as end:
        failed = not isinstance(end, SystemExit) or end.code == FAILED
        if failed and file.fails():
            file.restarts = True
        if not file.restarts:
            raise
        if not isinstance(end, SystemExit):
            click.echo(f"rcpd: {end!r}", err=True)
    run_again()


@main.command()
def plugins() -> None:
    """List the installed plugins, and what to install for those that cannot be used."""
    import importlib

    from rcp_gateway.plugins import GROUPS, installed
    from rcpd.installed import obstacle

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


def _new(kind: str) -> click.Command:
    """Create the command that generates a plugin of a kind."""

    @click.command(
        kind,
        help=f"Generate {'an' if kind[0] in 'aeiou' else 'a'} {kind} plugin with its own distribution "
        "that passes the public test suite.",
    )
    @click.argument("name")
    @click.option(
        "--into",
        type=click.Path(path_type=Path),
        default=Path(),
        help="Parent folder. Default: the current folder.",
    )
    def write(name: str, into: Path) -> None:
        try:
            made = write_plugin(kind, name, into)
        except StartupError as error:
            fail(str(error))
        click.echo(f"Wrote {made}. Next:")
        click.echo(f"  pip install -e {shlex.quote(f'{made}[test]')}")  # zsh expands brackets
        click.echo(f"  pytest {shlex.quote(str(made))}")

    return write


for _kind in KINDS:
    new.add_command(_new(_kind))


@main.command()
def version() -> None:
    """Print the gateway's and the protocol's version."""
    click.echo(f"rcp-gateway {gateway_version()} (protocol RCP/{VERSION})")


def _listening(config: GatewayConfig, host: str | None, port: int | None) -> GatewayConfig:
    """Return a configuration that listens where the command line says."""
    given = {key: at for key, at in (("host", host), ("port", port)) if at is not None}
    if not given:
        return config
    if "asgi" not in config.transports:
        fail("--host and --port are of [transports.asgi], which this configuration takes out")
    asgi = {**config.transports["asgi"], **given}
    return msgspec.structs.replace(config, transports={**config.transports, "asgi": asgi})


def _loaded(path: Path) -> GatewayConfig:
    try:
        return load(path)
    except ConfigError as error:
        fail(explained(error, path))
