"""Subcommands for those who write programs and models that use a gateway."""

from __future__ import annotations

from typing import Any

import click

from rcp_client.subcommands.options import CONTEXT, common, run

__all__ = ["codegen", "mcp"]


@click.group(context_settings=CONTEXT)
@common
def mcp() -> None:
    """Look at what the gateway offers to models (MCP)."""


@mcp.command(name="tools", context_settings=CONTEXT)
@common
@click.option("--cost", is_flag=True, help="Show about how many tokens each tool costs a model.")
@click.option("--path", default="/mcp", show_default=True, help="Path of the MCP server.")
@click.pass_context
def mcp_tools(ctx: click.Context, **arguments: Any) -> int:
    """List the tools that a model sees with your rights.

    --cost is an estimate, the same for every model: the bytes of a tool's JSON divided by 4.
    """
    return run(ctx, "mcp tools", **arguments)


@click.command(context_settings=CONTEXT)
@common
@click.option("--lang", required=True, type=click.Choice(["go", "python", "rust", "typescript"]),
              help="Output language.")  # fmt: skip
@click.argument("pattern", required=False)
@click.pass_context
def codegen(ctx: click.Context, **arguments: Any) -> int:
    """Generate a typed client module for all resources (or those matching PATTERN)."""
    return run(ctx, "codegen", **arguments)
