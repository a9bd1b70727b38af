"""The store on which a command works: from a configuration, or given as a file."""

from __future__ import annotations

from pathlib import Path

import click

from rcp_kernel.config.file import load
from rcp_kernel.errors import ConfigError
from rcpd.exits import fail

__all__ = ["config_argument", "path_of", "store_option"]

config_argument = click.argument("config", type=click.Path(path_type=Path), default="rcp.toml")
store_option = click.option(
    "--store", type=click.Path(path_type=Path), help="Database file, instead of a configuration."
)


def path_of(config: Path) -> Path:
    """Return the store of a configuration; end the command if there is none."""
    try:
        path = load(config).store.path
    except ConfigError as error:
        fail(str(error))
    if path is None:
        fail(f"{config} has no [store] path, so there is no store")
    return Path(path).expanduser()
