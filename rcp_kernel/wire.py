"""`rcp_protocol.wire`, under the name that plugins import."""

from __future__ import annotations

from rcp_protocol.wire import (
    FINAL,
    NO_BODY,
    VERSION,
    Body,
    Reply,
    Request,
    RequestType,
    Status,
    check_size,
    decode_request,
    encode_body,
    encode_frame,
    encode_reply,
    error_body,
    failure,
    fields_of,
    peek_header,
)

__all__ = [
    "FINAL",
    "NO_BODY",
    "VERSION",
    "Body",
    "Reply",
    "Request",
    "RequestType",
    "Status",
    "check_size",
    "decode_request",
    "encode_body",
    "encode_frame",
    "encode_reply",
    "error_body",
    "failure",
    "fields_of",
    "peek_header",
]
