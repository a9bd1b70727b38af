"""Exit codes and error messages of commands."""

from __future__ import annotations

import sys
from typing import NoReturn

import click

__all__ = ["FAILED", "RECORD_LOST", "fail"]

FAILED = 1
RECORD_LOST = 3


def fail(text: str) -> NoReturn:
    """Exit with an error message."""
    click.echo(f"rcpd: {text}", err=True)
    sys.exit(FAILED)
