"""Subcommands that look for resources, and read and write them."""

from __future__ import annotations

from typing import Any

import click

from rcp_client.subcommands.options import CONTEXT, WITH_VALUE, common, complete, run, watched

__all__ = ["discover", "read", "write"]


@click.command(context_settings=CONTEXT)
@common
@click.argument("pattern", required=False, shell_complete=complete("any"))
@watched
@click.option("--kind", type=click.Choice(["sensor", "actuator", "param", "action", "service",
                                           "event"]), help="Only resources of this kind.")  # fmt: skip
@click.option("--op", type=click.Choice(["read", "write", "execute", "subscribe"]),
              help="Only resources on which you may use this operation.")  # fmt: skip
@click.option("-q", "--query", "q", metavar="WORDS", help="Words in the path or description.")
@click.option("--profile", metavar="NAME", help="Only resources that this profile defines.")
@click.pass_context
def discover(ctx: click.Context, **arguments: Any) -> int:
    """List resources; for a single path, show the resource with its schemas and examples."""
    return run(ctx, "discover", **arguments)


@click.command(context_settings=CONTEXT)
@common
@click.argument(
    "paths", nargs=-1, required=True, metavar="PATH...", shell_complete=complete("read")
)
@watched
@click.option("--field", "fields", multiple=True, metavar="NAME",
              help="Only this field (position.x); can be repeated.")  # fmt: skip
@click.option("--frame", metavar="NAME",
              help="The frame of the values: map, base_link, earth.")  # fmt: skip
@click.option(
    "--fresh", is_flag=True, help="Read from the robot, even if a recent value is available."
)
@click.pass_context
def read(ctx: click.Context, **arguments: Any) -> int:
    """Print the current value of each PATH, or of everything that a PATTERN matches."""
    return run(ctx, "read", **arguments)


@click.command(context_settings=WITH_VALUE)
@common
@click.argument("words", nargs=-1, required=True, metavar="PATH VALUE | PATH=VALUE...",
                shell_complete=complete("write"))  # fmt: skip
@click.option("--valid-for", type=float, metavar="SECONDS",
              help="Time after which the gateway stops the robot unless the value is written "
                   "again.")  # fmt: skip
@click.option("--dry-run", is_flag=True, help="Check the request without changing anything.")
@click.option(
    "--key", metavar="TEXT", help="Idempotency key: a repeated request is not executed again."
)
@click.option("--approval", metavar="ID", help="Id of an approval, if the command requires one.")
@click.pass_context
def write(ctx: click.Context, **arguments: Any) -> int:
    """Write VALUE to PATH and print the value now in effect.

    PATH=VALUE, several times, writes several paths of one robot as one: all of them or none.
    """
    return run(ctx, "write", **arguments)
