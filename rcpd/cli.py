"""`rcpd`: demo, serve, check, plugins, profiles, new, audit, token, version, plugin commands."""

from __future__ import annotations

import sqlite3
import sys
from contextlib import suppress
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import click

from rcp_kernel.config.file import GatewayConfig, load, parse
from rcp_kernel.errors import ConfigError, StartupError
from rcp_store.damage import find_damage
from rcpd.audit import audit
from rcpd.exits import FAILED, fail
from rcpd.profiles import profiles
from rcpd.scaffold import KINDS, write_plugin
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
def main() -> None:
    """Run and manage an RCP gateway: one server between robots and their clients."""


main.add_command(audit)
main.add_command(profiles)
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
def serve(config: Path) -> None:
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
        run(_loaded(config), str(config), file, None)
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
@click.argument("config", type=click.Path(path_type=Path))
def check(config: Path) -> None:
    """Report every error of a configuration without opening a robot or a socket."""
    from rcp_kernel.access.identities import store_file
    from rcp_kernel.app.server import prepare
    from rcpd.key_strength import weak_keys

    try:
        prepared = prepare(load(config), str(config))
    except StartupError as error:
        fail(str(error))
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
            f"warning: key '{name}' is easy to guess: use the output of `openssl rand -hex 32` "
            f"instead, or a token: `rcpd token create {name} --config {config} --role ROLE`",
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
    click.echo(f"  issuers       {', '.join(one['issuer'] for one in found.jwt) or 'none'}")
    strangers = sorted({role for _, roles in found.anonymous.grants for role in roles})
    click.echo(f"  anonymous     {', '.join(strangers) or 'refused'}")
    if prepared.plugins.missing:
        sys.exit(FAILED)


@main.command()
def plugins() -> None:
    """List the installed plugins, and what to install for those that cannot be used."""
    import importlib

    from rcp_kernel.app.plugins import GROUPS, installed, obstacle

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
        click.echo(f"  pip install -e {made}[test]")
        click.echo(f"  pytest {made}")

    return write


for _kind in KINDS:
    new.add_command(_new(_kind))


@main.command()
def version() -> None:
    """Print the gateway's and the protocol's version."""
    from rcp_kernel.contract.version import gateway_version
    from rcp_kernel.wire import VERSION

    click.echo(f"rcp-gateway {gateway_version()} (protocol RCP/{VERSION})")


def _warn_of_damage(path: Path | None) -> None:
    """Warn of a damaged store: the gateway starts with one, but latches its robots."""
    if path is None:
        return
    with suppress(sqlite3.Error, OSError):  # `serve` reports what is wrong
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
        fail(str(error))
