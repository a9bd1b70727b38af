"""How a command ends: its exit codes, and the sentence that says why."""

from __future__ import annotations

import sys
from typing import NoReturn

import click

__all__ = ["FAILED", "RECORD_LOST", "fail"]

FAILED = 1
RECORD_LOST = 3


def fail(text: str) -> NoReturn:
    """End the command with a sentence."""
    click.echo(f"rcpd: {text}", err=True)
    sys.exit(FAILED)
