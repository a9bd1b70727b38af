"""No secrets in URLs: they would end up in logs, histories and Referer headers."""

from __future__ import annotations

from urllib.parse import parse_qsl

from rcp_kernel.errors import BadRequest
from rcp_web.asgi import Scope

__all__ = ["check_url"]

_SECRETS = frozenset(
    (
        *("token", "access_token", "id_token", "refresh_token", "resume_token", "bearer", "jwt"),
        *("key", "api_key", "apikey", "auth", "authorization", "password", "secret"),
    )
)


def check_url(scope: Scope, allowed: frozenset[str] = frozenset()) -> None:
    """Refuse a query that contains a secret; its value is neither evaluated nor reported.

    `allowed` are the names of parameters that may.

    :raises BadRequest: it does.
    """
    query: bytes = scope["query_string"]
    if not query:
        return
    for name, _ in parse_qsl(query.decode("latin-1"), keep_blank_values=True):
        if name.strip().lower().replace("-", "_") in _SECRETS and name not in allowed:
            raise BadRequest(
                f"the URL has a parameter `{name.strip()}`; secrets are not allowed in URLs",
                remedy="Send `Authorization: Bearer <token>`, or `token` in `hello` on the "
                "WebSocket; and change the secret: it may be in logs.",
            )
