"""What needs a library of the extra `console` says so in one line."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

import click

__all__ = ["needs"]


@contextmanager
def needs(what: str) -> Generator[None]:
    """Import libraries of the extra within the block."""
    try:
        yield
    except ImportError as error:
        raise click.UsageError(f"{what} needs more: pip install 'rcp-client[console]'") from error
