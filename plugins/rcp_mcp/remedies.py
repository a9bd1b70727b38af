"""What to do about an error, in the words of a model: tools and buttons, no envelope fields."""

from __future__ import annotations

import re
from typing import Any

__all__ = ["in_tools"]

_TOKEN = "Tell the person who set this server up that its token"  # noqa: S105 - no token
_CONTROL = (
    'Acquire control: `execute` with path `/system/leases` and input {"do": "acquire", "scope": '
    '"<path of the robot>", "ttl": 60}, then call the tool again.'
)
_BY_CODE = {
    "adapter_unavailable": "Wait a few seconds, then call the tool again; `status` shows the state "
    "of each robot's connection.",
    "approval_required": "Ask a person to approve it (Approvals on the dashboard), then call the "
    "same tool again, unchanged but for `approval`: '{approval}'.",
    "deadline_exceeded": "Call `status` and `read` to see what the robot did, then call the tool "
    "again with a longer `deadline` if it is still needed.",
    "device_timeout": "Call `read` and `status` to see what the robot does before you try again.",
    "duplicate_request": "Use a new `idempotency_key` for a new command.",
    "estop_active": "Tell a person: only somebody whose role may reset the e-stop can release it, "
    "once the robot is safe. Do not try to work around it.",
    "gap": "Call the tool again.",
    "lease_held": "Another client has control; `read` of `/system/leases` shows who, and until when. "
    "Wait, or have a person ask them.",
    "lease_lost": f"Control was lost. {_CONTROL}",
    "lease_required": _CONTROL,
    "overrun": "Call `watch` again, with a lower `rate` or fewer paths.",
    "queue_full": "Wait until earlier calls have ended, then call the tool again.",
    "rate_limited": "Wait {retry_after} s, then make fewer calls.",
    "segment_corrupt": "Call the tool again.",
    "segment_missing": "Call the tool again.",
    "stale_command": "Call the tool again if it is still needed.",
    "token_expired": f"{_TOKEN} has expired.",
    "unauthenticated": f"{_TOKEN} is missing or wrong.",
    "version_unsupported": "Tell the person who set this server up to update it.",
}
"""The gateway's remedies for these name fields that a model does not have."""
_WORDS = (
    (
        re.compile(r"^Send one envelope, .*"),
        "Call the tool with arguments that fit its input schema.",
    ),
    (
        re.compile(r"^Send a smaller message;.*"),
        "Ask for less in one call: fewer paths, `fields`, or a shorter value.",
    ),
    (
        re.compile(r"\bsend (?:it|them|the(?: same)? (?:command|request|plan)) again\b"),
        "call the tool again",
    ),
    (
        re.compile(r"\bSend (?:it|them|the(?: same)? (?:command|request|plan)) again\b"),
        "Call the tool again",
    ),
    (re.compile(r"\bSend a new command\b"), "Call the tool again"),
    (re.compile(r"\bUse `discover` to list\b"), "Call `discover` for"),
)


def in_tools(error: dict[str, Any]) -> str | None:
    """Return the remedy of an `error` object for a model."""
    known = _BY_CODE.get(error["code"])
    if known is not None:
        approval = (error.get("details") or {}).get("approval", "")
        if "{approval}" in known and not approval:
            return (
                "Ask a person to approve it (Approvals on the dashboard), then call the tool again."
            )
        wait = error.get("retry_after") or 1
        return known.replace("{approval}", str(approval)).replace("{retry_after}", f"{wait:g}")
    remedy: str | None = error.get("remedy")
    for pattern, words in _WORDS:
        remedy = None if remedy is None else pattern.sub(words, remedy)
    return remedy
