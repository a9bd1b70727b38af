"""The address of a gateway, parsed from user input."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import urlsplit, urlunsplit

__all__ = ["DEFAULT_URL", "Address"]

DEFAULT_URL = "http://127.0.0.1:8080"
_WS_PATH = "/rcp/v1/ws"
_SECURE = {"http": False, "ws": False, "https": True, "wss": True}


@dataclass(frozen=True, slots=True)
class Address:
    """The address of a gateway."""

    url: str
    """URL of its HTTP root, without a trailing slash."""
    ws: str
    host: str
    port: int
    secure: bool

    @classmethod
    def parse(cls, text: str) -> Address:
        """Parse `http://host:port`, `wss://host/prefix` or plain `host:port`.

        :raises ValueError: it is none of these.
        """
        whole = text if "://" in text else f"http://{text}"
        parts = urlsplit(whole)
        secure = _SECURE.get(parts.scheme)
        if secure is None or not parts.hostname:
            raise ValueError(f"{text!r} is not a gateway address such as {DEFAULT_URL}")
        port = parts.port or (443 if secure else 80)
        prefix = parts.path.rstrip("/").removesuffix(_WS_PATH)
        return cls(
            url=urlunsplit(("https" if secure else "http", parts.netloc, prefix, "", "")),
            ws=urlunsplit(("wss" if secure else "ws", parts.netloc, prefix + _WS_PATH, "", "")),
            host=parts.hostname,
            port=port,
            secure=secure,
        )
