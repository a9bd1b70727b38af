"""Subcommands on leases."""

from __future__ import annotations

from typing import Any

import click

from rcp_client.subcommands.options import CONTEXT, F, common, complete, run, watched

__all__ = ["lease"]


@click.group(context_settings=CONTEXT)
@common
def lease() -> None:
    """Take exclusive control of a tenant, a robot, or a sub-tree such as /actuator."""


@lease.command(name="list", context_settings=CONTEXT)
@common
@watched
@click.pass_context
def lease_list(ctx: click.Context, **arguments: Any) -> int:
    """List leases and their holders."""
    return run(ctx, "lease list", **arguments)


def _acquiring(function: F) -> F:
    options = (
        click.argument("scope", shell_complete=complete("robots")),
        click.option(
            "--ttl",
            type=click.FloatRange(0, min_open=True),
            metavar="SECONDS",
            help="Time until the lease expires unless renewed [the gateway's default].",
        ),
        click.option(
            "--take", is_flag=True, help="Take the lease over from holders with a lower priority."
        ),
        click.option(
            "--reason",
            metavar="TEXT",
            help="Reason; required with --take, shown to the previous holder.",
        ),
    )
    for option in reversed(options):
        function = option(function)
    return function


@lease.command(name="acquire", context_settings=CONTEXT)
@common
@_acquiring
@click.pass_context
def lease_acquire(ctx: click.Context, **arguments: Any) -> int:
    """Acquire SCOPE for all sessions of your principal until it expires or is released."""
    return run(ctx, "lease acquire", **arguments)


@lease.command(name="release", context_settings=CONTEXT)
@common
@click.argument("scope")
@click.pass_context
def lease_release(ctx: click.Context, **arguments: Any) -> int:
    """Release the lease; running commands continue."""
    return run(ctx, "lease release", **arguments)


@lease.command(name="hold", context_settings=CONTEXT)
@common
@_acquiring
@click.pass_context
def lease_hold(ctx: click.Context, **arguments: Any) -> int:
    """Hold the lease on SCOPE until Ctrl-C, or until someone takes it over."""
    return run(ctx, "lease hold", **arguments)
