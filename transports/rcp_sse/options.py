"""From query parameters to the body of `subscribe`."""

from __future__ import annotations

from typing import Any

import msgspec

from rcp_kernel.errors import BadRequest
from rcp_web.query import single

__all__ = ["MOST", "Query", "Wish", "subscription"]

_NUMBERS = ("rate", "duration")
_INTEGERS = ("count",)
_LISTS = ("fields",)
_JSON = ("where", "qos")
_TEXTS = ("on", "encoding", "frame")
_QOS = {"reliability": str, "depth": int, "priority": int, "lifespan": float, "qos.deadline": float}
"""Parts of `qos` that may be given alone: `reliability=reliable`, or as `qos.reliability`."""
_OTHER = ("path", "paths", "history", "initial", "deadband", "id", "tenant", "last_event_id")
Query = dict[str, list[str]]
MOST = 2000  # parameters
Wish = tuple[str, dict[str, Any]]
"""The first path, and the body."""


def subscription(query: Query, path: str | None) -> Wish:
    """Build the subscription of a query; `path` comes from the URL, or is None.

    :raises BadRequest: a parameter is unknown or invalid, or there is no path.
    """
    paths = [*query.get("path", ()), *query.get("paths", ())]
    if path is not None:
        if paths:
            raise BadRequest("the path of this stream is already in its URL")
        paths = [path]
    if not paths:
        raise BadRequest("no path given", remedy="Add ?path=<path or pattern>.")
    body: dict[str, Any] = {"paths": paths[1:]} if len(paths) > 1 else {}
    qos: dict[str, Any] = {}
    for name, values in query.items():
        if name in _OTHER and name not in ("history", "initial", "deadband"):
            continue
        part = name.removeprefix("qos.") if name != "qos.deadline" else name
        if part in _QOS:
            qos[part.removeprefix("qos.")] = _cast(name, single(name, values), _QOS[part])
        else:
            body[name] = _value(name, values)
    if qos:
        if "qos" in body and not isinstance(body["qos"], dict):
            raise BadRequest("`qos` is an object")
        body["qos"] = {**body.get("qos", {}), **qos}
    return paths[0], body


def _value(name: str, values: list[str]) -> Any:
    if name in _LISTS:
        return [part for part in ",".join(values).split(",") if part]
    text = single(name, values)
    if name in _NUMBERS:
        return _cast(name, text, float)
    if name in _INTEGERS:
        return _cast(name, text, int)
    if name in _JSON:
        return _json(name, text)
    if name == "initial":
        return _flag(name, text)
    if name == "history":
        return int(text) if text.isdigit() else text
    if name == "deadband":
        return _json(name, text) if text.startswith("{") else _number_or_text(text)
    if name in _TEXTS:
        return text
    if name.startswith("x-"):
        raise BadRequest("custom fields are not supported on a stream")
    raise BadRequest(
        f"unknown parameter {name[:60]!r}",
        remedy="The parameters are path and the options of `subscribe`: rate, on, deadband, where, "
        "fields, frame, history, initial, qos, duration, count.",
    )


def _cast(name: str, text: str, kind: type[Any]) -> Any:
    try:
        return kind(text)
    except ValueError:
        raise BadRequest(f"`{name}` must be a number, not {text[:40]!r}") from None


def _json(name: str, text: str) -> Any:
    try:
        return msgspec.json.decode(text)
    except msgspec.DecodeError as error:
        raise BadRequest(f"`{name}` must be JSON: {error}") from None


def _flag(name: str, text: str) -> bool:
    known = {"true": True, "1": True, "": True, "false": False, "0": False}
    if text.lower() not in known:
        raise BadRequest(f"`{name}` must be true or false, not {text[:40]!r}")
    return known[text.lower()]


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text
