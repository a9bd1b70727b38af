"""The emergency stop for models: its scope, and which robots are at rest."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

from rcp_protocol.plain import is_list, is_map
from rcp_web.untrusted import marked

__all__ = ["ESTOP", "Report", "is_hold", "stop_arguments", "stop_result", "stop_words"]

ESTOP = "/system/estop"
_HOLD = re.compile(r"/tenant/[^/]+/service/([^/]+/)?hold\Z")
_SHOWN = 50  # maximum number of robots named in the text
_SCOPE = (
    "What to stop: a robot by its backend's name (`rover-alpha`; one of several: "
    "`<backend>/<robot>`) or by its place (`/tenant/alpha/<robot>`), a group by its name, a tenant "
    "(`/tenant/alpha`). Default: every robot that you may stop."
)
_RESET = "Reset the e-stop instead; only for roles with that right. Nothing starts to move."
_REASON = "Shown to everyone who looks at the stop."
_NAMES = {"type": "array", "items": {"type": "string"}}


def is_hold(path: str) -> bool:
    """Return whether a path is a robot's hold: rest without a latch."""
    return _HOLD.match(path) is not None


def stop_words() -> str:
    """Return the description of the emergency stop tool."""
    return (
        "Acts at once and stays latched until a person with the right resets it. `completed` "
        "means that every robot in scope is confirmed at rest (`at_rest`). `failed` with "
        "`device_timeout` means that some are not: `not_confirmed` lists them, the gateway "
        "keeps sending the stop, and a person must use the robot's own emergency stop: say so at "
        "once. Never say that a robot has stopped before it is listed in `at_rest`. To pause one "
        "robot without a latch, execute its `service/hold`."
    )


def stop_arguments(schema: dict[str, Any]) -> dict[str, Any]:
    """Describe each argument in the tool's input schema."""
    words = {"scope": _SCOPE, "reset": _RESET, "reason": _REASON}
    properties = {
        name: one | {"description": words[name]} if name in words else one
        for name, one in schema["properties"].items()
        if name != "deadline"  # a stop has no time limit
    }
    return schema | {"properties": properties}


def stop_result() -> dict[str, Any]:
    """Return the tool's output schema: the parts of a report."""
    unconfirmed = {
        "type": "object",
        "properties": {
            "robot": {"type": "string"},
            "state": {"enum": ["requested", "commanded", "moves again"]},
            "detail": {"type": "string"},
        },
        "required": ["robot", "state"],
    }
    added = {
        "at_rest": _NAMES | {"description": "Stopped robots that are confirmed at rest."},
        "not_confirmed": {
            "type": "array",
            "items": unconfirmed,
            "description": "Stopped robots that are not known to be at rest.",
        },
    }
    return {"type": "object", "properties": added}


class Report(NamedTuple):
    """Which of the latched robots are at rest."""

    at_rest: list[str]
    not_confirmed: list[dict[str, Any]]

    @classmethod
    def of(cls, state: Any) -> Report:
        """Build it from the e-stop's state, or from the `details` of its error."""
        robots = state.get("robots") if is_map(state) else None
        rest: list[str] = []
        others: list[dict[str, Any]] = []
        if is_list(robots):
            others = [{"robot": str(name), "state": "requested"} for name in robots]
        for name, entry in robots.items() if is_map(robots) else ():
            known: dict[str, Any] = entry if is_map(entry) else {"state": entry}
            phase, alarm = known.get("state"), known.get("alarm") is True
            if phase == "confirmed":
                rest.append(str(name))
                continue
            # A robot without confirmation does not count as at rest.
            sent = "commanded" if phase == "commanded" else "requested"
            facts: dict[str, Any] = {"robot": str(name), "state": "moves again" if alarm else sent}
            if known.get("detail"):
                facts["detail"] = str(known["detail"])
            others.append(facts)
        return cls(rest, others)

    @property
    def facts(self) -> dict[str, Any]:
        """The content of the structured result."""
        return {"at_rest": self.at_rest, "not_confirmed": self.not_confirmed}

    def words(self) -> str:
        """Return it as text for a model; reasons given by a backend are marked."""
        lines: list[str] = []
        if self.at_rest:
            lines.append(f"Confirmed at rest: {_named(self.at_rest)}.")
        if self.not_confirmed:
            names = _named([one["robot"] for one in self.not_confirmed])
            lines.append(
                f"NOT confirmed at rest: {names}. The gateway keeps sending the stop; tell a "
                "person to use "
                "the robot's own emergency stop."
            )
            known = [one for one in self.not_confirmed if "detail" in one]
            reasons = [f"{one['robot']} ({one['state']}): {one['detail']}" for one in known]
            if reasons:
                lines.append(marked("\n".join(reasons[:_SHOWN]), ESTOP))
        return "\n".join(lines)


def _named(names: list[str]) -> str:
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
