"""The error tree: one class a code of the wire contract, each with the way out.

    RcpError
    ├── Refused                     nothing was changed; the reply's status is `rejected`
    │   ├── BadRequest              bad_request            malformed envelope or encoding
    │   ├── InvalidPath             invalid_path
    │   ├── UnknownPath             unknown_path           also: hidden from this principal
    │   ├── UnsupportedOperation    unsupported_operation  with the allowed ones
    │   ├── InvalidValue            invalid_value          fails the path's schema
    │   │   └── OutOfRange          out_of_range           fails a bound of it
    │   ├── Unauthenticated         unauthenticated
    │   │   └── TokenExpired        token_expired
    │   ├── Forbidden               forbidden
    │   │   └── ApprovalRequired    approval_required
    │   ├── LeaseRequired · LeaseHeld · LeaseLost
    │   ├── EstopActive             estop_active
    │   ├── ModeForbids · PreconditionFailed
    │   ├── StaleCommand            stale_command
    │   ├── DuplicateRequest        duplicate_request
    │   ├── AlreadyRunning          already_running
    │   ├── QueueFull               queue_full
    │   ├── RateLimited             rate_limited           with retry_after
    │   ├── PayloadTooLarge         payload_too_large
    │   ├── SegmentMissing · SegmentCorrupt
    │   ├── Gap                     gap                    replay buffer too small
    │   ├── VersionUnsupported · FilterUnsupported
    │   ├── NotImplementedByRobot   not_implemented
    │   └── AdapterUnavailable      adapter_unavailable    backend or adapter not connected
    ├── Failed                      it was tried; the reply's status is `failed`
    │   ├── DeviceRejected          device_rejected        the robot refused, with its reason
    │   ├── DeviceTimeout           device_timeout         the robot did not answer
    │   ├── DeadlineExceeded        deadline_exceeded
    │   ├── Overrun                 overrun                a reliable subscription fell behind
    │   └── InternalError           internal
    ├── Cancelled                   cancelled              status `cancelled`
    └── StartupError                never on the wire
        ├── ConfigError             stop for good: the configuration must change
        ├── NotReady                try again with backoff: the robot is not there yet
        └── PluginError             a plugin breaks a rule of the house

Plugins raise these; the kernel turns them into replies. Any other exception that leaves a plugin
becomes `internal` and is logged with its traceback, which the client never sees.
"""

from __future__ import annotations

from typing import Any, ClassVar

__all__ = [
    "BY_CODE",
    "AdapterUnavailable",
    "AlreadyRunning",
    "ApprovalRequired",
    "BadRequest",
    "Cancelled",
    "ConfigError",
    "DeadlineExceeded",
    "DeviceRejected",
    "DeviceTimeout",
    "DuplicateRequest",
    "EstopActive",
    "Failed",
    "FilterUnsupported",
    "Forbidden",
    "Gap",
    "InternalError",
    "InvalidPath",
    "InvalidValue",
    "LeaseHeld",
    "LeaseLost",
    "LeaseRequired",
    "ModeForbids",
    "NotImplementedByRobot",
    "NotReady",
    "OutOfRange",
    "Overrun",
    "PayloadTooLarge",
    "PluginError",
    "PreconditionFailed",
    "QueueFull",
    "RateLimited",
    "RcpError",
    "Refused",
    "SegmentCorrupt",
    "SegmentMissing",
    "StaleCommand",
    "StartupError",
    "TokenExpired",
    "Unauthenticated",
    "UnknownPath",
    "UnsupportedOperation",
    "VersionUnsupported",
]


class RcpError(Exception):
    """Base of every error a client may see.

    `remedy` says what to do next, for a person or a model; each class has one of its own, and a
    raiser that knows better passes a better one.
    """

    code: ClassVar[str] = "internal"
    http: ClassVar[int] = 500
    status: ClassVar[str] = "failed"
    retryable: ClassVar[bool] = False
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


class BadRequest(Refused):
    """The envelope or its encoding is malformed."""

    code = "bad_request"
    http = 400
    default_remedy = "Send one envelope of docs/protocol.md, section 3, in the agreed encoding."


class InvalidPath(Refused):
    """The text is not a path or pattern of the tree."""

    code = "invalid_path"
    http = 400
    default_remedy = (
        "Write /tenant/<tenant>/<branch>/<name> or /<branch>/<name>; a segment is [A-Za-z0-9_.-]+."
    )


class UnknownPath(Refused):
    """No such resource, or one that this principal may not discover."""

    code = "unknown_path"
    http = 404
    default_remedy = "Send `discover` to list the paths there are."


class UnsupportedOperation(Refused):
    """The resource exists and does not offer this operation."""

    code = "unsupported_operation"
    http = 405
    default_remedy = "Use one of the operations that `discover` lists for this path."


class InvalidValue(Refused):
    """The value does not fit the path's schema; `details.pointer` names the field."""

    code = "invalid_value"
    http = 422
    default_remedy = "Send a value that fits the path's schema; `discover` shows it with examples."


class OutOfRange(InvalidValue):
    """The value has the right type and lies outside a bound of the schema."""

    code = "out_of_range"
    default_remedy = "Send a value inside the bounds; `discover` shows them."


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
    default_remedy = "Ask a person with the right to approve it."


class LeaseRequired(Refused):
    """The path is commanded only under a lease."""

    code = "lease_required"
    http = 423
    default_remedy = "Acquire a lease on the sub-tree first."


class LeaseHeld(Refused):
    """Somebody else holds the lease."""

    code = "lease_held"
    http = 423
    retryable = True
    default_remedy = "Wait for the holder to release it, or take it over with a higher priority."


class LeaseLost(Refused):
    """The lease lapsed or was taken over."""

    code = "lease_lost"
    http = 423
    default_remedy = "Acquire the lease again before you command."


class EstopActive(Refused):
    """An emergency stop is latched."""

    code = "estop_active"
    http = 423
    default_remedy = (
        "Make sure the robot is safe, then have a person with the right reset the e-stop."
    )


class ModeForbids(Refused):
    """The robot's mode does not allow this now."""

    code = "mode_forbids"
    http = 409
    default_remedy = "Bring the robot into a mode that allows it."


class PreconditionFailed(Refused):
    """A condition on other resources does not hold, or cannot be known."""

    code = "precondition_failed"
    http = 409
    default_remedy = "Bring about the condition that the message names, then send it again."


class StaleCommand(Refused):
    """The command is older than its path allows."""

    code = "stale_command"
    http = 409
    default_remedy = "Send a fresh command with the present time; check that the clocks agree."


class DuplicateRequest(Refused):
    """An id or idempotency key is in use with another body."""

    code = "duplicate_request"
    http = 409
    default_remedy = "Use a new id or key for a new request."


class AlreadyRunning(Refused):
    """The action is running, and its policy is `reject`."""

    code = "already_running"
    http = 409
    retryable = True
    default_remedy = "Wait for the running command to end, or cancel it."


class QueueFull(Refused):
    """A bounded queue has no room; `retry_after` says when to look again."""

    code = "queue_full"
    http = 503
    retryable = True
    default_remedy = "Wait for earlier requests to finish, then send it again."

    def __init__(self, message: str, *, retry_after: float = 1.0, **more: Any) -> None:
        super().__init__(message, retry_after=retry_after, **more)


class RateLimited(Refused):
    """Too many requests; `retry_after` says when to come back."""

    code = "rate_limited"
    http = 429
    retryable = True
    default_remedy = "Wait `retry_after` seconds, then send fewer requests."


class PayloadTooLarge(Refused):
    """The message is longer than the limit."""

    code = "payload_too_large"
    http = 413
    default_remedy = "Send less at once; `hello` and the details name the limit."


class SegmentMissing(Refused):
    """A segmented transfer ended or timed out with a part missing."""

    code = "segment_missing"
    http = 400
    retryable = True
    default_remedy = "Send the missing segments again, or the whole transfer under a new id."


class SegmentCorrupt(Refused):
    """A segmented transfer does not match its size or hash."""

    code = "segment_corrupt"
    http = 400
    retryable = True
    default_remedy = "Send the whole transfer again under a new id."


class Gap(Refused):
    """What was missed is not in the replay buffer any more."""

    code = "gap"
    http = 410
    default_remedy = "Subscribe afresh; read the present values for what the gap hides."


class VersionUnsupported(Refused):
    """The envelope asks for a protocol version that the gateway does not speak."""

    code = "version_unsupported"
    http = 400
    default_remedy = 'Send version "1".'


class FilterUnsupported(Refused):
    """A filter or option does not apply to this resource."""

    code = "filter_unsupported"
    http = 400
    default_remedy = "Drop the option that the message names, or use it on a path that has it."


class NotImplementedByRobot(Refused):
    """The robot or gateway does not have this function."""

    code = "not_implemented"
    http = 501
    default_remedy = "Use another path or option; this gateway does not have the function."


class AdapterUnavailable(Refused):
    """The backend or adapter behind the path is not connected."""

    code = "adapter_unavailable"
    http = 503
    retryable = True
    default_remedy = "Check that the robot is on and reachable; `status` shows each backend."


class Failed(RcpError):
    """Tried, and not brought to a good end."""


class DeviceRejected(Failed):
    """The robot refused; the message carries its reason."""

    code = "device_rejected"
    http = 502
    default_remedy = "Remove the cause that the robot names, then send it again."


class DeviceTimeout(Failed, TimeoutError):
    """The robot did not answer in time."""

    code = "device_timeout"
    http = 504
    retryable = True
    default_remedy = "Check the robot and its link; look at its state before you send it again."


class DeadlineExceeded(Failed, TimeoutError):
    """The request's deadline passed before the answer was there."""

    code = "deadline_exceeded"
    http = 504
    retryable = True
    default_remedy = "Look at the state of the robot, then send it again with a longer `deadline`."


class Overrun(Failed):
    """A reliable subscription fell further behind than its queue is deep."""

    code = "overrun"
    http = 503
    default_remedy = "Subscribe again with a lower rate, a deeper queue, or `best_effort`."


class InternalError(Failed):
    """A fault of the gateway or a plugin; the log has the traceback under `trace_id`."""

    code = "internal"
    http = 500


class Cancelled(RcpError):
    """The command was cancelled."""

    code = "cancelled"
    http = 499
    status = "cancelled"
    default_remedy = "Send it again if it is still wanted."


class StartupError(Exception):
    """Base of what stops a plugin, or the gateway, from coming up."""


class ConfigError(StartupError):
    """The configuration is wrong: only a change of it helps, so nothing is retried."""


class NotReady(StartupError):
    """The robot is not there yet: the supervisor tries again with backoff."""


class PluginError(StartupError):
    """A plugin breaks a rule: an async hook, a misspelt one, a name taken twice."""


def _leaves(root: type[RcpError]) -> dict[str, type[RcpError]]:
    found: dict[str, type[RcpError]] = {}
    for child in root.__subclasses__():
        if "code" in vars(child):
            found[child.code] = child
        found.update(_leaves(child))
    return found


BY_CODE: dict[str, type[RcpError]] = _leaves(RcpError)
"""Every wire code with its class, for clients that turn a reply back into an exception."""
