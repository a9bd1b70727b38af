"""Permissions of files that only the gateway's user may access."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from rcp_protocol.errors import ConfigError

__all__ = ["READ", "WRITE", "check_store_modes", "others_may"]

READ = stat.S_IRGRP | stat.S_IROTH
WRITE = stat.S_IWGRP | stat.S_IWOTH
_STORE = ("", ".head", ".lock", ".latches", ".interim", "-wal", "-shm")
"""Name suffixes of the files of a store."""


def others_may(path: Path, bits: int) -> bool:
    """Return whether the group or others have any of `bits`; False if the file does not exist."""
    if os.name == "nt":  # the mode does not reflect its access control lists
        return False
    try:
        return bool(path.stat().st_mode & bits)
    except OSError:
        return False


def check_store_modes(path: Path) -> str | None:
    """Return a warning if other users can read a store, or None.

    :raises ConfigError: others can write it, and thus create tokens and records.
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
