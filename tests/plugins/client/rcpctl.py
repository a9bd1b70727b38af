"""What the tests of `rcpctl` share: who they are, and how they read what it prints."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from configuration import backend, key, listener

__all__ = [
    "ADMIN",
    "BIN",
    "BOUND",
    "CONFIG",
    "FAR",
    "NEAR",
    "OPERATOR",
    "Run",
    "document",
    "documents",
]

BIN = Path(sys.executable).parent
BOUND = 60.0  # s that any process of these tests may take
OPERATOR = "operator-of-the-rcpctl-tests"
ADMIN = "administrator-of-the-rcpctl-tests"
CONFIG = (
    listener(grace=0.1)
    + backend("rover", use="sim")
    + key("operator", OPERATOR)
    + key("admin", ADMIN)
)
Run = Callable[..., subprocess.CompletedProcess[str]]
FAR = '{"position": {"x": 0, "y": 9}}'
NEAR = '{"position": {"x": 0, "y": 0}}'


def documents(done: subprocess.CompletedProcess[str]) -> list[dict[str, Any]]:
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def document(done: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    (found,) = documents(done)
    return found
