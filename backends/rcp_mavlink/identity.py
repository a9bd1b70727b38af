"""What a vehicle is, from its heartbeat and its AUTOPILOT_VERSION."""

from __future__ import annotations

from typing import Any

from rcp_kernel.spi import RobotFacts
from rcp_mavlink.vehicle import Vehicle

__all__ = ["describe"]

_NAMES = {"ardupilot": "ArduPilot", "px4": "PX4"}
_TYPES = (255, ""), (192, "-rc"), (128, "-beta"), (64, "-alpha"), (0, "-dev")
"""FIRMWARE_VERSION_TYPE: the least value of each, and how it is written behind the version."""
_SHORT = 8  # digits of a git hash
_HEX = frozenset(b"0123456789abcdef")


def describe(vehicle: Vehicle) -> RobotFacts:
    """Return what is known by now; versions and numbers only once the vehicle has sent them."""
    family = vehicle.family
    frame = vehicle.latest.get("AUTOPILOT_VERSION")
    version: dict[str, Any] = {} if frame is None else frame.fields()
    return RobotFacts(
        kind="submarine" if family.kind == "sub" else family.kind,
        vendor=_number(version.get("vendor_id", 0)),
        model=_number(version.get("product_id", 0)),
        firmware=_firmware(family.autopilot, version),
        serial=_serial(version),
        frames=("map",),
    )


def _firmware(autopilot: str, version: dict[str, Any]) -> str | None:
    number = version.get("flight_sw_version", 0)
    words: list[str] = []
    if autopilot in _NAMES:
        words.append(_NAMES[autopilot])
    if number:
        major, minor, patch, type_ = number.to_bytes(4, "big")
        suffix = next(text for least, text in _TYPES if type_ >= least)
        words.append(f"{major}.{minor}.{patch}{suffix}")
    if commit := _commit(autopilot, bytes(version.get("flight_custom_version", b""))):
        words.append(f"({commit})")
    return " ".join(words) or None


def _commit(autopilot: str, raw: bytes) -> str:
    """Return the start of the git hash: ArduPilot sends it as text, PX4 as a number."""
    text = raw.rstrip(b"\0")
    if autopilot == "ardupilot":
        return text.decode() if text and _HEX.issuperset(text) else ""
    return raw[::-1].hex()[:_SHORT] if autopilot == "px4" and text else ""


def _serial(version: dict[str, Any]) -> str | None:
    """Return the number of the hardware: `uid2` supersedes `uid`, unless it is zero."""
    long = bytes(version.get("uid2", b"")).rstrip(b"\0")
    if long:
        return long.hex()
    short: int = version.get("uid", 0)
    return f"{short:016x}" if short else None


def _number(value: int) -> str | None:
    """Write a USB id; 0 is none."""
    return f"0x{value:04x}" if value else None
