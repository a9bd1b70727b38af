"""The base of all errors: what they carry, and the status of the reply."""

from __future__ import annotations

from typing import Any, ClassVar

__all__ = ["Cancelled", "Failed", "InternalError", "RcpError", "Refused"]


class RcpError(Exception):
    """Base of every error a client may see.

    `remedy` says what to do next, for people and models. Each class has a default; a caller with
    more context passes its own.
    """

    code: ClassVar[str] = "internal"
    http: ClassVar[int] = 500
    status: str = "failed"
    """The status of the reply; an instance may say otherwise than its class."""
    retryable: bool = False
    """Whether the same request can succeed later; an instance may say otherwise than its class."""
    default_remedy: ClassVar[str] = "Report this to the operator of the gateway."

    def __init__(
        self,
        message: str,
        *,
        path: str | None = None,
        origin: str | None = None,
        remedy: str | None = None,
        retry_after: float | None = None,
        details: dict[str, Any] | None = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.path = path
        self.origin = origin
        self.remedy = remedy if remedy is not None else self.default_remedy
        self.retry_after = retry_after
        self.details = details
        self.trace_id: str | None = None


class Refused(RcpError):
    """Refused before anything was changed."""

    status = "rejected"


class Failed(RcpError):
    """Attempted, but not completed."""


class Cancelled(RcpError):
    """The command was cancelled."""

    code = "cancelled"
    http = 499
    status = "cancelled"
    default_remedy = "Send it again if it is still needed."


class InternalError(Failed):
    """A fault of the gateway or a plugin; the log has the traceback under `trace_id`."""

    code = "internal"
    http = 500
