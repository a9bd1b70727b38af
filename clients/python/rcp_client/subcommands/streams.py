"""Subcommands that follow values."""

from __future__ import annotations

from typing import Any

import click

from rcp_client.subcommands.options import CONTEXT, common, complete, run

__all__ = ["plot", "top", "watch"]


@click.command(context_settings=CONTEXT)
@common
@click.argument("patterns", nargs=-1, required=True, metavar="PATTERN...",
                shell_complete=complete("subscribe"))  # fmt: skip
@click.option("--rate", type=click.FloatRange(0, min_open=True), metavar="HZ",
              help="Maximum updates per second and path.")  # fmt: skip
@click.option("--count", type=click.IntRange(1), metavar="N", help="Stop after N updates.")
@click.option("--duration", type=click.FloatRange(0, min_open=True), metavar="SECONDS",
              help="Stop after this time.")  # fmt: skip
@click.option(
    "--history", metavar="N|SPAN", help="Start with the last N samples, or those of the last 30s."
)
@click.option("--change", is_flag=True, help="Only values that differ from the previous one.")
@click.option("--deadband", metavar="NUMBER|P%|JSON", help="Only changes of at least this size.")
@click.option(
    "--where", metavar="JSON", help='Only samples that match, e.g. {"field":"voltage","lt":11.1}.'
)
@click.option("--field", "fields", multiple=True, metavar="NAME",
              help="Only this field (position.x); can be repeated.")  # fmt: skip
@click.option("--frame", metavar="NAME",
              help="The frame of the values: map, base_link, earth.")  # fmt: skip
@click.option("--reliable", is_flag=True, help="Deliver every sample in order, or fail.")
@click.option("--initial/--no-initial", default=True, help="Start with the current value [yes].")
@click.pass_context
def watch(ctx: click.Context, **arguments: Any) -> int:
    """Print a line for every new value until Ctrl-C; notices go to standard error."""
    return run(ctx, "watch", **arguments)


@click.command(context_settings=CONTEXT)
@common
@click.argument("patterns", nargs=-1, required=True, metavar="PATTERN...",
                shell_complete=complete("subscribe"))  # fmt: skip
@click.option("--field", "fields", multiple=True, metavar="NAME",
              help="Only this field (position.x); can be repeated.")  # fmt: skip
@click.option("--rate", type=click.FloatRange(0, min_open=True), metavar="HZ", default=20.0,
              help="Maximum updates per second and path [20].")  # fmt: skip
@click.option("--span", type=click.FloatRange(0, min_open=True), metavar="SECONDS", default=30.0,
              help="Time from the left to the right edge [30].")  # fmt: skip
@click.option("--history", metavar="N|SPAN", help="Start with samples of the past, such as 30s.")
@click.option("--count", type=click.IntRange(1), metavar="N", help="Stop after N updates.")
@click.option("--duration", type=click.FloatRange(0, min_open=True), metavar="SECONDS",
              help="Stop after this time.")  # fmt: skip
@click.option("--frame", metavar="NAME", help="The frame of the values: map, base_link, earth.")
@click.pass_context
def plot(ctx: click.Context, **arguments: Any) -> int:
    """Draw the numbers of paths over time, until Ctrl-C: seven lines at most."""
    return run(ctx, "plot", **arguments)


@click.command(context_settings=CONTEXT)
@common
@click.option("--once", is_flag=True, help="Show it once, after a second.")
@click.pass_context
def top(ctx: click.Context, **arguments: Any) -> int:
    """Show a screen of robots, rates, running commands and warnings until Ctrl-C."""
    return run(ctx, "top", **arguments)
