"""What a vehicle would answer to a frame that is not passed on, in the words of MAVLink."""

from __future__ import annotations

from typing import Any, NamedTuple

from rcp_mavlink.dialect import Dialect
from rcp_mavlink.frames import Frame
from rcp_mavlink.signing import Signing

__all__ = ["Answers", "Refusal"]

_TEMPORARILY_REJECTED, _DENIED, _FAILED = 1, 2, 4  # MAV_RESULT
_MISSION_DENIED = 14  # MAV_MISSION_DENIED
_WARNING = 4  # MAV_SEVERITY
_TEXT = 50  # bytes of a STATUSTEXT
_AGAIN = 5.0  # s until the same refusal is told again
_PASSING = frozenset({"estop_active", "lease_held", "lease_lost", "lease_required", "mode_forbids"})
"""Refusals that end by themselves."""
_MISSIONS = frozenset({
    "MISSION_COUNT", "MISSION_CLEAR_ALL", "MISSION_WRITE_PARTIAL_LIST", "MISSION_ITEM",
    "MISSION_ITEM_INT",
})  # fmt: skip


class Refusal(NamedTuple):
    """Why a frame went no further."""

    code: str
    retryable: bool
    details: dict[str, Any]

    @classmethod
    def of(cls, error: dict[str, Any]) -> Refusal:
        """Read the `error` of a reply."""
        return cls(error["code"], bool(error.get("retryable")), error.get("details") or {})


class Answers:
    """Refusals for one ground station, sent as if by the vehicle."""

    def __init__(self, dialect: Dialect, signing: Signing | None) -> None:
        self._module = dialect.module
        self._signing = signing
        self._told: dict[str, float] = {}

    def of(self, frame: Frame, refusal: Refusal, vehicle: int, now: float) -> list[bytes]:
        """Return the frames that tell a ground station why its frame went no further."""
        made: list[Any] = []
        name, to = frame.definition.name, (frame.system, frame.component)
        module = self._module
        result = _TEMPORARILY_REJECTED if refusal.code in _PASSING else _DENIED
        if refusal.retryable and refusal.code not in _PASSING:
            result = _FAILED
        if name in ("COMMAND_LONG", "COMMAND_INT"):
            command = frame.fields()["command"]
            made.append(module.MAVLink_command_ack_message(command, result, 0, 0, *to))
        elif name == "SET_MODE":
            made.append(module.MAVLink_command_ack_message(176, result, 0, 0, *to))
        elif name in _MISSIONS:
            kind = frame.fields().get("mission_type", 0)
            made.append(module.MAVLink_mission_ack_message(*to, _MISSION_DENIED, kind))
        if now - self._told.get(refusal.code, -_AGAIN) >= _AGAIN:
            self._told[refusal.code] = now
            text = f"Gateway: {_words(refusal)}".encode()[:_TEXT]
            made.append(module.MAVLink_statustext_message(_WARNING, text))
        return [self._packed(message, vehicle) for message in made]

    def _packed(self, message: Any, vehicle: int) -> bytes:
        sink = _Sink()
        mav = self._module.MAVLink(sink, vehicle, 1)
        if self._signing is not None:
            self._signing.apply(mav, 0)
        mav.send(message)
        return sink.frame


class _Sink:
    frame = b""

    def write(self, frame: bytes) -> None:
        self.frame = bytes(frame)


def _words(refusal: Refusal) -> str:
    """Return a refusal so short that a ground station shows it whole."""
    match refusal.code:
        case "lease_held" | "lease_lost":
            return f"{refusal.details.get('holder') or refusal.details.get('by') or 'another'} has control"
        case "estop_active":
            return "emergency stop, reset it first"
        case "forbidden" | "unauthenticated" | "unknown_path":
            return "look only, no right to command"
        case _:
            return refusal.code.replace("_", " ")
