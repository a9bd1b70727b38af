"""Programs that tests take from the machine."""

from __future__ import annotations

import os
import shutil

import pytest

__all__ = ["program"]


def program(name: str) -> str:
    """Return where a program is; without it there is no test, except where it is a must (`RCP_CI`).

    The distribution's comes first: it is the oldest that users have (a Rust of 2022 in Debian 12),
    and a compiler that somebody installed for himself accepts more.
    """
    found = shutil.which(name, path=f"/usr/bin:/usr/sbin:{os.environ['PATH']}")
    if found is not None:
        return found
    reason = f"{name} is not installed"
    if os.environ.get("RCP_CI"):
        pytest.fail(reason)
    pytest.skip(reason)
