"""COMPONENT_METADATA and COMPONENT_INFORMATION, which pymavlink's own dialects lack, to be received."""

from __future__ import annotations

import struct
from typing import Any, ClassVar

__all__ = ["COMPONENT_MESSAGES"]


class _Received:
    """What `Definition` needs of a class that pymavlink generates."""

    fieldunits_by_name: ClassVar[dict[str, str]] = {"time_boot_ms": "ms"}
    fieldenums_by_name: ClassVar[dict[str, str]] = {}


class ComponentMetadata(_Received):
    """Where the metadata of a component are."""

    id = 397
    msgname = "COMPONENT_METADATA"
    crc_extra = 182
    unpacker = struct.Struct("<II100s")
    fieldnames: ClassVar[list[str]] = ["time_boot_ms", "file_crc", "uri"]
    ordered_fieldnames = fieldnames
    fieldtypes: ClassVar[list[str]] = ["uint32_t", "uint32_t", "char"]
    orders: ClassVar[list[int]] = [0, 1, 2]
    lengths: ClassVar[list[int]] = [1, 1, 1]
    array_lengths: ClassVar[list[int]] = [0, 0, 100]


class ComponentInformation(_Received):
    """Where the metadata of a component are, by the message that COMPONENT_METADATA replaces."""

    id = 395
    msgname = "COMPONENT_INFORMATION"
    crc_extra = 0
    unpacker = struct.Struct("<III100s100s")
    fieldnames: ClassVar[list[str]] = [
        "time_boot_ms", "general_metadata_file_crc", "general_metadata_uri",
        "peripherals_metadata_file_crc", "peripherals_metadata_uri",
    ]  # fmt: skip
    ordered_fieldnames: ClassVar[list[str]] = [
        "time_boot_ms", "general_metadata_file_crc", "peripherals_metadata_file_crc",
        "general_metadata_uri", "peripherals_metadata_uri",
    ]  # fmt: skip
    fieldtypes: ClassVar[list[str]] = ["uint32_t", "uint32_t", "char", "uint32_t", "char"]
    orders: ClassVar[list[int]] = [0, 1, 3, 2, 4]
    lengths: ClassVar[list[int]] = [1, 1, 1, 1, 1]
    array_lengths: ClassVar[list[int]] = [0, 0, 0, 100, 100]


COMPONENT_MESSAGES: dict[int, Any] = {397: ComponentMetadata, 395: ComponentInformation}
"""By their numbers."""
