"""Files that are for the gateway's user alone, and whether they are."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from rcp_kernel.errors import ConfigError

__all__ = ["READ", "WRITE", "check_store_modes", "others_may"]

READ = stat.S_IRGRP | stat.S_IROTH
WRITE = stat.S_IWGRP | stat.S_IWOTH
_STORE = ("", ".head", ".lock", ".latches", ".interim", "-wal", "-shm")
"""What a store consists of, by what is added to its name."""


def others_may(path: Path, bits: int) -> bool:
    """Tell whether a file's group or others have one of some permissions; no, if it is not there."""
    if os.name == "nt":  # it has other rights, of which the mode says nothing
        return False
    try:
        return bool(path.stat().st_mode & bits)
    except OSError:
        return False


def check_store_modes(path: Path) -> str | None:
    """Return what to tell the operator if others may read a store, or None.

    :raises ConfigError: others may write it, and so make tokens and records.
    """
    files = [path.with_name(path.name + suffix) for suffix in _STORE]
    for file in files:
        if others_may(file, WRITE):
            raise ConfigError(
                f"other users can write the store file '{file}' and create tokens: check it "
                f"(`rcpd token list`, `rcpd audit verify`), then run "
                f"`chmod 600 {file}`"
            )
    for file in files:
        if others_may(file, READ):
            return (
                f"other users can read '{file}', which contains the audit log: run `chmod "
                f"600 {file}`"
            )
    return None
