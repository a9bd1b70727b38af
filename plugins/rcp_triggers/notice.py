"""What is delivered to targets: a message about a trigger, with an id of its own."""

from __future__ import annotations

from typing import Any, Literal

import msgspec

from rcp_kernel.clock import iso
from rcp_triggers.spec import Severity

__all__ = ["Delivery", "Notice", "NoticeType"]

NoticeType = Literal["trigger.fired", "trigger.cleared", "trigger.stopped", "trigger.resumed"]


class Notice(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The content."""

    firing: str
    """Id of the firing, the same for all targets."""
    trigger: str
    tenant: str
    robot: str
    severity: Severity
    message: str
    condition: str
    values: dict[str, Any] = {}
    alarm: str | None = None
    by: str | None = None
    detail: str | None = None
    """Why the trigger stopped."""


class Delivery(msgspec.Struct, frozen=True, kw_only=True):
    """A notice for one target, as the store keeps it."""

    id: str
    """The same in every attempt, also after a restart."""
    number: int
    """Its place in the order of all deliveries."""
    target: str
    type: NoticeType
    created: int
    """ns since the UNIX epoch."""
    notice: Notice

    @property
    def title(self) -> str:
        """A line for people."""
        did = self.type.partition(".")[2]
        what = "" if did == "fired" else f"{did}: "
        return f"{self.notice.severity}: {what}{self.notice.robot} {self.notice.trigger}"

    @property
    def text(self) -> str:
        """Some lines for people."""
        notice = self.notice
        values = [f"{name} = {value}"[:200] for name, value in notice.values.items()]
        lines = [notice.message, "", f"Robot: {notice.robot}", f"Trigger: {notice.trigger}"]
        if notice.detail is not None:
            lines = [f"The trigger watches no longer: {notice.detail}", "", *lines]
        lines += [f"Condition: {notice.condition}", *values, f"Time: {iso(self.created)}"]
        if notice.alarm is not None:
            lines.append(f"Alarm: {notice.alarm}")
        return "\n".join(lines)

    def body(self) -> bytes:
        """Return it as JSON, in the form of Standard Webhooks."""
        return msgspec.json.encode(
            {"type": self.type, "timestamp": iso(self.created), "data": self.notice}
        )
