"""Parameter metadata of the autopilots: ArduPilot's `apm.pdef.xml`, PX4's `parameters.json`."""

from __future__ import annotations

import gzip
import lzma
import math
import zlib
from collections.abc import Iterable
from typing import Any
from xml.etree import ElementTree as ET

import msgspec

from rcp_mavlink.metadata import About

__all__ = ["described"]

_LARGEST = 64 << 20  # bytes
_UNITS = {
    "": "1", "%": "%", "deg/s": "deg/s", "degC": "Cel", "m/s/s": "m/s2", "m/s^2": "m/s2",
    "cm/s/s": "cm/s2", "mAh": "mA.h", "PWM": "us", "norm": "1", "bit": "1", "Ohm": "Ohm",
    "rad/s/s": "rad/s2", "m/s/s/s": "m/s3", "cdeg/s": "cdeg/s", "gauss": "G", "mGauss": "mG",
}  # fmt: skip


_WRONG = (
    ET.ParseError, msgspec.MsgspecError, lzma.LZMAError, zlib.error, OSError, EOFError,
    AttributeError, KeyError, TypeError,
)  # fmt: skip


def described(data: bytes) -> dict[str, About]:
    """Parse parameter metadata, from plain or compressed XML or JSON.

    :raises ValueError: the data is neither.
    """
    try:
        plain = _unpacked(data)
        if plain.lstrip()[:1] == b"<":
            return dict(_of_xml(plain))
        return dict(_of_json(plain))
    except _WRONG as error:
        raise ValueError(f"neither apm.pdef.xml nor parameters.json: {error}") from error


def _unpacked(data: bytes) -> bytes:
    if data[:6] == b"\xfd7zXZ\0":
        return lzma.LZMADecompressor().decompress(data, _LARGEST)
    if data[:2] == b"\x1f\x8b":
        return gzip.decompress(data)[:_LARGEST]
    return data


def _of_xml(data: bytes) -> Iterable[tuple[str, About]]:
    root = ET.fromstring(data)  # noqa: S314 - expat limits entity expansion
    if root.tag != "paramfile":
        raise KeyError("paramfile")
    for param in root.iter("param"):
        name = param.attrib["name"].rpartition(":")[2]
        fields = {field.get("name"): (field.text or "").strip() for field in param.iter("field")}
        values = {
            code: (value.text or "").strip()
            for value in param.iter("value")
            if (code := value.get("code")) is not None
        }
        text = " ".join(param.get("documentation", "").split())
        yield (
            name,
            About(
                _sentence(text or param.get("humanName", ""), name),
                _unit(fields.get("Units", "")),
                _range(fields.get("Range", "").replace(",", " ").split()),
                values,
                _bits(fields.get("Bitmask", "")),
                restart=fields.get("RebootRequired", "").lower() == "true",
            ),
        )


def _of_json(data: bytes) -> Iterable[tuple[str, About]]:
    for param in msgspec.json.decode(data)["parameters"]:
        text = param.get("longDesc") or param.get("shortDesc") or ""
        limits = [param[end] for end in ("min", "max") if end in param]
        yield (
            param["name"],
            About(
                _sentence(" ".join(text.split()), param["name"]),
                _unit(param.get("units", "")),
                _range(limits),
                _listed(param.get("values"), "value"),
                _listed(param.get("bitmask"), "index"),
                restart=bool(param.get("rebootRequired", False)),
                group=str(param.get("group", "")),
                default=_number(param.get("default")),
            ),
        )


def _listed(entries: Any, key: str) -> dict[str, str]:
    return {str(entry[key]): str(entry["description"]) for entry in entries or ()}


def _bits(text: str) -> dict[str, str]:
    pairs = (part.partition(":") for part in text.split(",") if ":" in part)
    return {bit.strip(): word.strip() for bit, _, word in pairs}


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _range(ends: list[Any]) -> tuple[float, float] | None:
    try:
        low, high = (float(end) for end in ends)
    except ValueError:
        return None
    return low, high


def _unit(unit: str) -> str:
    return _UNITS.get(unit, unit.replace(" ", "") or "1")


def _sentence(text: str, name: str) -> str:
    text = text or f"Parameter {name} of the autopilot"
    return text if text.endswith(".") else f"{text}."
