"""Conversion between the protocol's messages and plain data."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any

import msgspec
from a2a.types.a2a_pb2 import Message, Part, SendMessageRequest
from a2a.utils.errors import ContentTypeNotSupportedError, InvalidParamsError
from a2a.utils.proto_utils import validate_proto_required_fields
from google.protobuf.json_format import ParseDict
from google.protobuf.struct_pb2 import Struct, Value

from rcp_kernel.values import Encoding
from rcp_kernel.wire import Reply, encode_reply
from rcp_protocol.plain import is_list, is_map
from rcp_protocol.trace import carried
from rcp_web.untrusted import UNTRUSTED, marked, speaks

__all__ = [
    "VALUES",
    "TaskRequest",
    "check",
    "check_fields",
    "count_values",
    "data_part",
    "parse_message",
    "plain",
    "plain_reply",
    "stamp",
    "text_part",
    "written",
]

_DATA = "application/json"
_TEXT = "text/plain"
_EXACT = 2**53
VALUES = 1024
"""Maximum values per message or task as data: the SDK needs 10 µs for each, mostly in one turn."""


class TaskRequest(msgspec.Struct, frozen=True):
    """The content of a message."""

    body: Any
    """A plan as for `/system/plans`, or the answer to a question."""
    dry_run: bool = False
    deadline: float | None = None
    words: bool = False
    """Whether the client accepts data only as text."""
    images: bool = True
    """Whether the client accepts images as files; otherwise they stay in the data."""
    custom: dict[str, Any] | None = None
    """The trace of the message: W3C trace context of its metadata."""


def check_fields(request: SendMessageRequest) -> None:
    """Refuse a message that lacks a required field; its data has no such fields.

    :raises InvalidParamsError: a field is missing.
    """
    bare = SendMessageRequest()
    bare.CopyFrom(request)
    bare.ClearField("metadata")
    bare.message.ClearField("metadata")
    for part in bare.message.parts:
        part.ClearField("metadata")
        if part.HasField("data"):
            part.data.CopyFrom(Value(bool_value=True))
    validate_proto_required_fields(bare)


def check(message: Message) -> None:
    """Refuse a message that does not have the form of a plan.

    :raises ContentTypeNotSupportedError: it has files, or types other than JSON and text.
    :raises InvalidParamsError: it contains several plans.
    """
    kinds = [part.WhichOneof("content") for part in message.parts]
    for part, kind in zip(message.parts, kinds, strict=True):
        media = part.media_type.partition(";")[0].strip().lower()
        if kind not in ("data", "text") or media not in ("", _DATA, _TEXT):
            raise ContentTypeNotSupportedError(
                f"a plan must be a data part or a text part ({_DATA}, {_TEXT}), not "
                f"{part.media_type or kind or 'nothing'}"
            )
    if kinds.count("data") > 1:
        raise InvalidParamsError("a message can contain one plan only: send one data part")


def parse_message(request: SendMessageRequest) -> TaskRequest:
    """Parse a message; if it has a data part, its text is for people only."""
    message = request.message
    options = {**plain(request.metadata), **plain(message.metadata)}
    data = [part.data for part in message.parts if part.WhichOneof("content") == "data"]
    if data:
        body = plain(data[0])
    else:
        texts = [part.text for part in message.parts if part.WhichOneof("content") == "text"]
        body = written("\n".join(texts))
    if isinstance(body, str):
        body = written(body)
    deadline = options.get("deadline")
    good = isinstance(deadline, (int, float)) and deadline > 0
    return TaskRequest(
        body,
        dry_run=options.get("dry_run") is True,
        deadline=float(deadline) if good else None,  # pyright: ignore[reportArgumentType]
        words=_wants_text(request.configuration.accepted_output_modes),
        images=_wants_images(request.configuration.accepted_output_modes),
        custom=carried(options),
    )


def _wants_text(modes: Iterable[str]) -> bool:
    """Return whether a client that lists its accepted types accepts text, but no data."""
    accepted = {mode.partition(";")[0].strip().lower() for mode in modes}
    return _TEXT in accepted and not accepted & {_DATA, "application/*", "*/*"}


def _wants_images(modes: Iterable[str]) -> bool:
    """Return whether a client accepts images; one that lists no types accepts all."""
    accepted = [mode.strip().lower() for mode in modes]
    return not accepted or any(mode.startswith(("image/", "*/")) for mode in accepted)


def written(text: str) -> Any:
    """Determine the kind of plan in a text: JSON, the symbolic plan of a planner, or commands."""
    stripped = text.strip()
    if stripped.startswith("{"):
        try:
            return msgspec.json.decode(stripped)
        except (msgspec.DecodeError, RecursionError):
            pass
    lines = [line for line in stripped.splitlines() if line.strip()[:1] not in ("", ";", "#")]
    first = lines[0].strip() if lines else ""
    symbolic = first.startswith("(") or first.partition(":")[2].lstrip().startswith("(")
    return {"symbolic" if symbolic else "lines": text}


def plain(value: Value | Struct | Any) -> Any:
    """Convert the protocol's data, where every number is a float, to data with integers."""
    if isinstance(value, Struct):
        return {name: plain(item) for name, item in value.fields.items()}
    match value.WhichOneof("kind"):
        case "number_value":
            number: float = value.number_value
            return int(number) if number.is_integer() and abs(number) <= _EXACT else number
        case "string_value":
            return value.string_value
        case "bool_value":
            return value.bool_value
        case "struct_value":
            return plain(value.struct_value)
        case "list_value":
            return [plain(item) for item in value.list_value.values]
        case _:
            return None


def plain_reply(reply: Reply) -> dict[str, Any]:
    """Encode a reply as on the wire, as plain data."""
    return msgspec.json.decode(encode_reply(reply, Encoding.JSON))


def count_values(plain: Any, most: int) -> int:
    """Count the values in plain data, up to `most` + 1."""
    waiting: list[Any] = [plain]
    count = 0
    while waiting and count <= most:
        node = waiting.pop()
        count += 1
        if is_map(node):
            waiting.extend(node.values())
        elif is_list(node):
            waiting.extend(node)
    return count


def data_part(value: Any, *, words: bool = False) -> Part:
    """Build a part from plain data, or from the text that it is; what robots say is marked."""
    if words:
        text = msgspec.json.encode(value).decode()
        return _noted(
            Part(text=marked(text, None) if speaks(value) else text, media_type=_TEXT), value
        )
    return _noted(Part(data=ParseDict(value, Value()), media_type=_DATA), value)


def text_part(value: Any) -> Part:
    """Build a part with plain data as JSON text, which is cheap for any number of values."""
    return _noted(Part(text=msgspec.json.encode(value).decode(), media_type=_DATA), value)


def _noted(part: Part, value: Any) -> Part:
    """Note in a part's metadata that its data may have text of a robot: marks would be data too."""
    if speaks(value):
        part.metadata.update({UNTRUSTED: True})
    return part


def stamp() -> str:
    """Return the present time in the specification's format: UTC, in milliseconds."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")
