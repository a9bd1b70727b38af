"""What PX4 tells of itself over MAVLink FTP: a list of files (COMPONENT_METADATA), one of its parameters."""

from __future__ import annotations

import json
import lzma
import struct
from functools import cache
from typing import Any, ClassVar

from rcp_mavlink_sim.ftp import checksum
from rcp_mavlink_sim.parameters_table import table
from rcp_mavlink_sim.px4.parameter_texts import GROUPS, TEXTS
from rcp_mavlink_sim.wire import mav

__all__ = ["ComponentMetadata", "component_metadata", "metadata_files"]

_FOLDER = "etc/extras"
_GENERAL = f"{_FOLDER}/component_general.json.xz"
_PARAMETERS, _EVENTS, _ACTUATORS = 1, 4, 5  # COMP_METADATA_TYPE
_TYPES = {"i": "Int32", "f": "Float"}


class ComponentMetadata(mav.MAVLink_message):
    """COMPONENT_METADATA, which pymavlink's dialect lacks."""

    id = 397
    msgname = "COMPONENT_METADATA"
    fieldnames: ClassVar[list[str]] = ["time_boot_ms", "file_crc", "uri"]
    ordered_fieldnames = fieldnames
    crc_extra = 182
    _layout: ClassVar[struct.Struct] = struct.Struct("<II100s")

    def __init__(self, time_boot_ms: int, file_crc: int, uri: str) -> None:
        super().__init__(self.id, self.msgname)
        self.time_boot_ms, self.file_crc, self.uri = time_boot_ms, file_crc, uri

    def pack(self, sender: Any, force_mavlink1: bool = False) -> bytes:  # noqa: FBT001, FBT002 - pymavlink's own call
        """Return it as a frame."""
        payload = self._layout.pack(self.time_boot_ms, self.file_crc, self.uri.encode())
        return self._pack(sender, self.crc_extra, payload, force_mavlink1=force_mavlink1)


def component_metadata(milliseconds: int) -> ComponentMetadata:
    """Return the message, at a time since boot."""
    return ComponentMetadata(
        milliseconds, checksum(metadata_files()[_GENERAL]), f"mftp://{_GENERAL}"
    )


@cache
def metadata_files() -> dict[str, bytes]:
    """Return the files by their paths, packed as PX4 packs them."""
    files = {
        f"{_FOLDER}/parameters.json.xz": (_PARAMETERS, {"version": 1, "parameters": _parameters()}),
        f"{_FOLDER}/all_events.json.xz": (_EVENTS, {"version": 2, "components": {}}),
        f"{_FOLDER}/actuators.json.xz": (
            _ACTUATORS,
            {"version": 1, "outputs_v1": [], "functions_v1": {}, "mixer_v1": {"config": []}},
        ),
    }
    packed = {path: _packed(content) for path, (_, content) in files.items()}
    types = [
        {"type": kind, "uri": f"mftp://{path}", "fileCrc": checksum(packed[path])}
        for path, (kind, _) in files.items()
    ]
    return packed | {_GENERAL: _packed({"version": 1, "metadataTypes": types})}


def _parameters() -> list[dict[str, Any]]:
    """Describe each parameter of the list."""
    return [_parameter(name, *kind) for name, kind in table("px4").items()]


def _parameter(name: str, kind: str, default: float) -> dict[str, Any]:
    known = TEXTS.get(name)
    group = next(
        (group for start, group in GROUPS.items() if name.startswith(start)), "Miscellaneous"
    )
    found: dict[str, Any] = {
        "name": name, "type": _TYPES[kind], "group": group, "category": "Standard",
        "default": default if kind == "f" else int(default),
    }  # fmt: skip
    if known is not None:
        found["shortDesc"] = known.text
        more = {"units": known.unit, "min": known.least, "max": known.most}
        found |= {key: value for key, value in more.items() if value is not None}
        if known.values:
            found["values"] = [
                {"value": value, "description": text} for value, text in known.values.items()
            ]
    return found


def _packed(content: dict[str, Any]) -> bytes:
    return lzma.compress(json.dumps(content).encode(), check=lzma.CHECK_CRC32)
