"""Request errors: malformed, unknown path, invalid value, too large."""

from __future__ import annotations

from rcp_protocol.errors.base import Refused

__all__ = [
    "BadRequest",
    "DuplicateRequest",
    "FilterUnsupported",
    "InvalidPath",
    "InvalidValue",
    "NotImplementedByRobot",
    "OutOfRange",
    "PayloadTooLarge",
    "SegmentCorrupt",
    "SegmentMissing",
    "UnknownPath",
    "UnsupportedOperation",
    "VersionUnsupported",
]


class BadRequest(Refused):
    """The envelope or its encoding is malformed."""

    code = "bad_request"
    http = 400
    default_remedy = (
        "Send one envelope, as docs/protocol.md describes it, in the negotiated encoding."
    )


class InvalidPath(Refused):
    """Not a valid path or pattern."""

    code = "invalid_path"
    http = 400
    default_remedy = (
        "Use /tenant/<tenant>/<branch>/<name> or /<branch>/<name>; a segment is [A-Za-z0-9_.-]+."
    )


class UnknownPath(Refused):
    """The resource does not exist, or the principal may not discover it."""

    code = "unknown_path"
    http = 404
    default_remedy = "Use `discover` to list the available paths."


class UnsupportedOperation(Refused):
    """The resource does not offer this operation."""

    code = "unsupported_operation"
    http = 405
    default_remedy = "Use one of the operations that `discover` lists for this path."


class InvalidValue(Refused):
    """The value does not match the path's schema; `details.pointer` names the field."""

    code = "invalid_value"
    http = 422
    default_remedy = (
        "Send a value that matches the path's schema; `discover` returns it with examples."
    )


class OutOfRange(InvalidValue):
    """The value has the right type but is out of bounds."""

    code = "out_of_range"
    default_remedy = "Send a value within the bounds; `discover` returns them."


class DuplicateRequest(Refused):
    """The id or idempotency key is in use for a different request."""

    code = "duplicate_request"
    http = 409
    default_remedy = "Use a new id or key for a new request."


class PayloadTooLarge(Refused):
    """The message exceeds the size limit."""

    code = "payload_too_large"
    http = 413
    default_remedy = "Send a smaller message; `details` and the reply to `hello` give the limit."


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


class VersionUnsupported(Refused):
    """The gateway does not support the requested protocol version."""

    code = "version_unsupported"
    http = 400
    default_remedy = 'Send version "1".'


class FilterUnsupported(Refused):
    """A filter or option does not apply to this resource."""

    code = "filter_unsupported"
    http = 400
    default_remedy = (
        "Remove the option that the message names, or use it on a path that supports it."
    )


class NotImplementedByRobot(Refused):
    """The robot or gateway does not have this function."""

    code = "not_implemented"
    http = 501
    default_remedy = "Use another path or option."
