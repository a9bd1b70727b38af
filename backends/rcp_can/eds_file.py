"""Electronic data sheets: EDS and DCF files of CANopen devices (CiA 306)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rcp_kernel.errors import ConfigError

if TYPE_CHECKING:
    from canopen.objectdictionary import ObjectDictionary

__all__ = ["load_eds"]


def load_eds(where: str, file: str, node: int) -> ObjectDictionary:
    """Read the object dictionary of an EDS or DCF file.

    :raises ConfigError: the file cannot be read.
    """
    import canopen

    try:
        found: Any = canopen.import_od(file, node)
    except Exception as error:
        raise ConfigError(f"{where}.eds: {file}: {error}") from error
    if not len(found):
        raise ConfigError(f"{where}.eds: {file} describes no objects; it must end in .eds or .dcf")
    return found
