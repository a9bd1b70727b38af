"""Programs that tests take from the machine."""

from __future__ import annotations

import os
import shutil

import pytest

__all__ = ["program"]


def program(name: str) -> str:
    """Return where a program is; without it there is no test, except where it is a must (`RCP_CI`)."""
    found = shutil.which(name, path=f"{os.environ['PATH']}:/usr/sbin")
    if found is not None:
        return found
    reason = f"{name} is not installed"
    if os.environ.get("RCP_CI"):
        pytest.fail(reason)
    pytest.skip(reason)
