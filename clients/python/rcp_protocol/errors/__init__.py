"""The error tree: one class per error code, each with a remedy.

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

from rcp_protocol.errors.base import Cancelled, Failed, InternalError, RcpError, Refused
from rcp_protocol.errors.request import (
    BadRequest,
    DuplicateRequest,
    FilterUnsupported,
    InvalidPath,
    InvalidValue,
    NotImplementedByRobot,
    OutOfRange,
    PayloadTooLarge,
    SegmentCorrupt,
    SegmentMissing,
    UnknownPath,
    UnsupportedOperation,
    VersionUnsupported,
)
from rcp_protocol.errors.rights import (
    ApprovalRequired,
    Forbidden,
    LeaseHeld,
    LeaseLost,
    LeaseRequired,
    RateLimited,
    TokenExpired,
    Unauthenticated,
)
from rcp_protocol.errors.startup import ConfigError, NotReady, PluginError, StartupError
from rcp_protocol.errors.state import (
    AdapterUnavailable,
    AlreadyRunning,
    DeadlineExceeded,
    DeviceRejected,
    DeviceTimeout,
    EstopActive,
    Gap,
    ModeForbids,
    Overrun,
    PreconditionFailed,
    QueueFull,
    StaleCommand,
)

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


def _leaves(root: type[RcpError]) -> dict[str, type[RcpError]]:
    found: dict[str, type[RcpError]] = {}
    for child in root.__subclasses__():
        if "code" in vars(child):
            found[child.code] = child
        found.update(_leaves(child))
    return found


BY_CODE: dict[str, type[RcpError]] = _leaves(RcpError)
"""Every wire code with its class, for clients that turn a reply back into an exception."""
