"""Access errors: no credentials, no right, no lease, or too many requests."""

from __future__ import annotations

from rcp_protocol.errors.base import Refused

__all__ = [
    "ApprovalRequired",
    "Forbidden",
    "LeaseHeld",
    "LeaseLost",
    "LeaseRequired",
    "RateLimited",
    "TokenExpired",
    "Unauthenticated",
]


class Unauthenticated(Refused):
    """No credentials, or unknown ones."""

    code = "unauthenticated"
    http = 401
    default_remedy = "Send `Authorization: Bearer <token>`, or `token` in `hello`."


class TokenExpired(Unauthenticated):
    """The credentials were valid but have expired."""

    code = "token_expired"
    default_remedy = "Get a new token and connect again."


class Forbidden(Refused):
    """The principal may see the resource but not use this operation."""

    code = "forbidden"
    http = 403
    default_remedy = "Ask the operator for a role that allows this operation on this path."


class ApprovalRequired(Forbidden):
    """The command requires approval."""

    code = "approval_required"
    default_remedy = "Ask someone who may approve it."


class LeaseRequired(Refused):
    """The path accepts commands only under a lease."""

    code = "lease_required"
    http = 423
    default_remedy = "Acquire a lease on the robot or sub-tree first."


class LeaseHeld(Refused):
    """Another client holds the lease."""

    code = "lease_held"
    http = 423
    retryable = True
    default_remedy = (
        "Wait until the holder releases it, or take it over if your priority is higher."
    )


class LeaseLost(Refused):
    """The lease expired or was taken over."""

    code = "lease_lost"
    http = 423
    default_remedy = "Acquire the lease again before you send commands."


class RateLimited(Refused):
    """Too many requests; wait `retry_after` seconds."""

    code = "rate_limited"
    http = 429
    retryable = True
    default_remedy = "Wait `retry_after` seconds, then send fewer requests."
