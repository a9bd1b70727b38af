"""The token of a client: from the caller, the environment, or a file of this user.

`rcpd demo` stores its key in a file that only its user can read, so that `rcpctl` on the same
machine needs no configuration.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

from rcp_client.address import Address

__all__ = ["find_token", "token_path"]

_ONLY_OWNER = 0o600


def token_path(url: str) -> Path:
    """Return the file in which a gateway of the same user may have stored a token."""
    address = Address.parse(url)
    host = "127.0.0.1" if address.host == "localhost" else address.host
    base = os.environ.get("XDG_RUNTIME_DIR") or str(Path.home() / ".cache")
    return Path(base) / "rcp" / f"{host}_{address.port}.token"


def find_token(url: str | None) -> str | None:
    """Return the token in `RCP_TOKEN`, or in the token file if only this user can access it.

    Without an address, only the one in `RCP_TOKEN`.
    """
    given = os.environ.get("RCP_TOKEN")
    return given or (None if url is None else _from_file(token_path(url)))


def _from_file(path: Path) -> str | None:
    try:
        with path.open(encoding="utf-8") as file:
            facts = os.fstat(file.fileno())
            is_own = not hasattr(os, "getuid") or facts.st_uid == os.getuid()
            if not is_own or stat.S_IMODE(facts.st_mode) & ~_ONLY_OWNER:
                return None
            return file.readline().strip() or None
    except (OSError, UnicodeDecodeError):
        return None
