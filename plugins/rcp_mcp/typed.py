"""The tool of one action or service: its name, description, schemas and hints."""

from __future__ import annotations

from typing import Any

import msgspec
from mcp import types

from rcp_mcp.config import McpConfig
from rcp_mcp.naming import tool_name
from rcp_mcp.provenance import Marker, is_own
from rcp_mcp.schemas import Arguments, arguments, result
from rcp_mcp.stops import ESTOP, is_hold, stop_arguments, stop_result, stop_words
from rcp_web.untrusted import speaks

__all__ = ["OPTIONS", "is_read_only", "typed_tool"]

OPTIONS: dict[str, dict[str, Any]] = {
    "deadline": {
        "type": "number",
        "exclusiveMinimum": 0,
        "maximum": 86400,
        "unit": "s",
        "description": "Maximum time; after it, the command fails and the robot stops.",
    },
    "wait": {
        "type": "number",
        "minimum": 0,
        "maximum": 3600,
        "unit": "s",
        "description": "Return after this time, while the command continues.",
    },
    "dry_run": {
        "type": "boolean",
        "description": "Check the command without running it, and return what would happen.",
    },
    "approval": {
        "type": "string",
        "maxLength": 128,
        "description": "Id of the approval for exactly this command, from the refusal.",
    },
}
_DESCRIPTION = 900  # maximum characters of a robot's own description


def typed_tool(
    facts: dict[str, Any],
    tenant: str | None,
    config: McpConfig,
    marker: Marker,
    *,
    stops: bool,
    asks: bool,
) -> tuple[types.Tool, Arguments]:
    """Build the tool of an executable resource, from its entry in the catalogue.

    `stops`: what cancelling its call does; `asks`: whether a person may have to approve it.
    """
    given = facts.get("command_schema") or facts.get("schemas", {}).get("input")
    outcome = {name: facts.get("schemas", {}).get(name) for name in ("output", "feedback")}
    examples: list[Any] = facts["examples"]
    if not is_own(facts["path"]):
        given, outcome = marker.schema(given), marker.schema(outcome)
        examples = [one for one in examples if not speaks(_plain(one))]
    long = facts["kind"] == "action"
    left_out = {"wait": not long, "approval": not asks}
    options = {name: one for name, one in OPTIONS.items() if not left_out.get(name)}
    taken = arguments(given, examples, options)
    path: str = facts["path"]
    answer = result(outcome.get("output"), outcome.get("feedback"))
    if path == ESTOP:
        taken = taken._replace(schema=stop_arguments(taken.schema))
        answer = stop_result()
    return (
        types.Tool(
            name=tool_name(path, tenant),
            description=_words(facts, config, marker, stops=stops),
            input_schema=taken.schema,
            output_schema=answer,
            annotations=_hints(facts),
            _meta={"rcp/path": path},
        ),
        taken,
    )


def _plain(value: Any) -> Any:
    return msgspec.to_builtins(value)


def _words(facts: dict[str, Any], config: McpConfig, marker: Marker, *, stops: bool) -> str:
    words = " ".join(str(facts["description"]).split())[:_DESCRIPTION]
    sentences = [words if is_own(facts["path"]) else marker.text(words)]
    if facts["path"] == ESTOP:
        sentences.append(stop_words())
    elif is_hold(facts["path"]):
        sentences.append(
            "No latch: the next command moves the robot. In an emergency use `system-estop`."
        )
    if facts["kind"] == "action":
        sentences.append(
            f"Long: after {config.wait:g} s (or `wait`) it returns `in_progress` and a command id."
        )
        sentences.append(
            "Cancelling the call stops the robot."
            if stops
            else "Cancelling the call does not cancel the command; use `cancel` for that."
        )
    if envelopes := facts.get("envelopes"):
        names = ", ".join(str(one.get("name")) for one in envelopes)
        sentences.append(f"Motion limits that apply: {names}.")
    sentences.append(f"Path {facts['path']}.")
    return " ".join(sentences)


def is_read_only(facts: dict[str, Any]) -> bool:
    """Return whether a command changes nothing, as its backend says."""
    return bool(_declared(facts).get("read_only", False))


def _declared(facts: dict[str, Any]) -> dict[str, Any]:
    meta = facts.get("meta", {})
    hints = meta.get("hints", {}) if isinstance(meta, dict) else {}  # pyright: ignore[reportUnknownVariableType, reportUnknownMemberType]
    return hints if isinstance(hints, dict) else {}  # pyright: ignore[reportUnknownVariableType]


def _hints(facts: dict[str, Any]) -> types.ToolAnnotations:
    """Return the hints about a call's effects, as far as the resource declares them."""
    hints = _declared(facts)
    stop = facts["path"] == ESTOP or is_hold(facts["path"])
    reads = is_read_only(facts)
    return types.ToolAnnotations(
        read_only_hint=reads,
        destructive_hint=bool(hints.get("destructive", not stop and not reads)),
        idempotent_hint=bool(hints.get("idempotent", stop or reads)),
        open_world_hint=facts["kind"] == "action",
    )
