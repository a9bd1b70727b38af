"""Who asks may not: nobody proved to be anybody, no right, no lease, or too much of it."""

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
    """No proof of identity, or one that is not known."""

    code = "unauthenticated"
    http = 401
    default_remedy = "Send `Authorization: Bearer <token>`, or `token` in `hello`."


class TokenExpired(Unauthenticated):
    """The proof was good and is not any more."""

    code = "token_expired"
    default_remedy = "Get a new token and connect again."


class Forbidden(Refused):
    """The principal may see the resource, and may not do this with it."""

    code = "forbidden"
    http = 403
    default_remedy = "Ask the operator for a role that allows this operation on this path."


class ApprovalRequired(Forbidden):
    """A person has to approve this command first."""

    code = "approval_required"
    default_remedy = "Ask someone who may approve it."


class LeaseRequired(Refused):
    """The path is commanded only under a lease."""

    code = "lease_required"
    http = 423
    default_remedy = "Acquire a lease on the robot or sub-tree first."


class LeaseHeld(Refused):
    """Somebody else holds the lease."""

    code = "lease_held"
    http = 423
    retryable = True
    default_remedy = (
        "Wait until the holder releases it, or take it over if your priority is higher."
    )


class LeaseLost(Refused):
    """The lease lapsed or was taken over."""

    code = "lease_lost"
    http = 423
    default_remedy = "Acquire the lease again before you send commands."


class RateLimited(Refused):
    """Too many requests; `retry_after` says when to come back."""

    code = "rate_limited"
    http = 429
    retryable = True
    default_remedy = "Wait `retry_after` seconds, then send fewer requests."
