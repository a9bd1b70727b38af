"""Subcommands on recordings and their replay."""

from __future__ import annotations

from typing import Any

import click

from rcp_client.subcommands.options import CONTEXT, common, connected, run

__all__ = ["record", "replay"]


@click.group(context_settings=CONTEXT)
@common
def record() -> None:
    """Record robots on the gateway, and download recordings (MCAP, ROS 2 bags, CSV, Parquet)."""


@record.command(name="list", context_settings=CONTEXT)
@common
@click.argument("words", nargs=-1)
@click.pass_context
def record_list(ctx: click.Context, **arguments: Any) -> int:
    """List recordings and incidents, or those with WORDS in file name, reason or robot."""
    return run(ctx, "record list", **arguments)


@record.command(name="start", context_settings=CONTEXT)
@common
@click.argument("name")
@click.argument("paths", nargs=-1, required=True, metavar="PATTERN...")
@click.option("--seconds", type=click.FloatRange(0, min_open=True), metavar="SECONDS",
              help="Stop after this time.")  # fmt: skip
@click.pass_context
def record_start(ctx: click.Context, **arguments: Any) -> int:
    """Start a recording of what matches the PATTERNs now and you may read."""
    return run(ctx, "record start", **arguments)


@record.command(name="stop", context_settings=CONTEXT)
@common
@click.argument("name")
@click.pass_context
def record_stop(ctx: click.Context, **arguments: Any) -> int:
    """Stop the recording NAME."""
    return run(ctx, "record stop", **arguments)


@record.command(name="pin", context_settings=CONTEXT)
@common
@click.argument("file")
@click.pass_context
def record_pin(ctx: click.Context, **arguments: Any) -> int:
    """Keep FILE: it is never deleted to make space."""
    return run(ctx, "record pin", **arguments)


@record.command(name="unpin", context_settings=CONTEXT)
@common
@click.argument("file")
@click.pass_context
def record_unpin(ctx: click.Context, **arguments: Any) -> int:
    """Let FILE be deleted when space is needed."""
    return run(ctx, "record unpin", **arguments)


@record.command(name="download", context_settings=CONTEXT)
@connected
@click.argument("file")
@click.option("-o", "--output", metavar="PATH", help="Where to save it [its own name, here].")
@click.option("--ros2", is_flag=True,
              help="Save its ROS messages as a bag that `ros2 bag play` plays.")  # fmt: skip
@click.pass_context
def record_download(ctx: click.Context, **arguments: Any) -> int:
    """Download FILE; a download that breaks off is continued."""
    return run(ctx, "record download", **arguments)


@record.command(name="history", context_settings=CONTEXT)
@connected
@click.argument("path")
@click.option("--from", "from", metavar="TIME", default="-1h", show_default=True,
              help="Beginning: ISO 8601, or a span before now (-10m).")  # fmt: skip
@click.option("--to", metavar="TIME", help="End [now].")
@click.option("--every", metavar="SPAN", help="Minimum, maximum and mean of each 10s, 1m, 1h.")
@click.option("--thin", is_flag=True, help="The first sample of each interval instead.")
@click.option("--field", "fields", multiple=True, metavar="NAME",
              help="Only this field (position.x); can be repeated.")  # fmt: skip
@click.option("--format", type=click.Choice(["csv", "arrow", "parquet", "mcap", "ros2"]),
              default="csv", show_default=True, help="Format of the file.")  # fmt: skip
@click.option("-o", "--output", metavar="FILE", help="Where to save it [named after the path].")
@click.pass_context
def record_history(ctx: click.Context, **arguments: Any) -> int:
    """Save what was recorded of PATH; for mcap and ros2, PATH may be a pattern."""
    return run(ctx, "record history", **arguments)


@click.command(context_settings=CONTEXT)
@common
@click.argument("path", required=False)
@click.option("--pause/--play", "paused", default=None, help="Stop the recording's time, or go on.")
@click.option("--speed", type=click.FloatRange(0, 1000, min_open=True), metavar="FACTOR",
              help="How many times as fast as it was recorded.")  # fmt: skip
@click.option("--seek", metavar="MOMENT", help="Seconds after the beginning, or ISO 8601.")
@click.option("--step", type=click.IntRange(1, 10_000), metavar="N", help="Play N messages.")
@click.option("--loop/--once", "loop", default=None, help="Begin again at the end, or not.")
@click.pass_context
def replay(ctx: click.Context, **arguments: Any) -> int:
    """Control the replay of a recording; without options, show where each one is.

    PATH is where it is played (/tenant/then), if the gateway replays several recordings.
    """
    return run(ctx, "replay", **arguments)
