"""The object dictionary of the simulated CiA 402 drive, for canopen's SDO server."""

from __future__ import annotations

import struct

from canopen import objectdictionary as od

from rcp_can.profiles.cia402_objects import OBJECTS, PDOS

__all__ = ["DEFAULTS", "HOMING_METHODS", "OBJECTS_OF_TWIN", "make_dictionary"]

_TYPES = {
    "b": od.INTEGER8,
    "h": od.INTEGER16,
    "i": od.INTEGER32,
    "B": od.UNSIGNED8,
    "H": od.UNSIGNED16,
    "I": od.UNSIGNED32,
}
DEFAULTS = {"abort_connection": 1, "quick_stop_option": 2}
"""Factory settings (CiA 402-2): a fault on a lost master, no torque after a quick stop."""
OBJECTS_OF_TWIN = {
    "following_error_window": (0x6065, 0, "I"),
    "following_error_timeout": (0x6066, 0, "H"),
    "quick_stop_deceleration": (0x6085, 0, "I"),
}
"""Objects that the gateway leaves as the drive has them."""
HOMING_METHODS = 1, 2, 17, 18, 35, 37
_ARRAYS = frozenset((0x60E3,))
_READ_ONLY = frozenset(("error_code", "statusword", "mode_shown", "position", "velocity", "torque"))


def make_dictionary(node: int) -> od.ObjectDictionary:
    """Create the dictionary, without PDO mapping."""
    made = od.ObjectDictionary()
    made.node_id = node
    _variable(made, "Device type", 0x1000, "I", 0x00020192, access="ro")
    _variable(made, "Error register", 0x1001, "B", 0, access="ro")
    identity = od.ODRecord("Identity", 0x1018)
    parts = (
        ("Entries", 4),
        ("Vendor", 0x1CA),
        ("Product", 402),
        ("Revision", 0x10002),
        ("Serial", node),
    )
    for sub, (name, value) in enumerate(parts):
        identity.add_member(_entry(name, 0x1018, sub, "I" if sub else "B", value, access="ro"))
    made.add_object(identity)
    consumer = od.ODArray("Consumer heartbeat", 0x1016)
    consumer.add_member(_entry("Entries", 0x1016, 0, "B", 1, access="ro"))
    consumer.add_member(_entry("Consumer", 0x1016, 1, "I", 0))
    made.add_object(consumer)
    for name, (index, sub, code) in (OBJECTS | OBJECTS_OF_TWIN).items():
        if sub == 0 and index not in _ARRAYS:
            access = "ro" if name in _READ_ONLY else "rw"
            text = name.replace("_", " ").capitalize()
            _variable(made, text, index, code, DEFAULTS.get(name, 0), access=access)
    interpolation = od.ODRecord("Interpolation time", 0x60C2)
    for sub, (name, code, value) in enumerate(
        (("Entries", "B", 2), ("Period", "B", 1), ("Exponent", "b", -3))
    ):
        interpolation.add_member(_entry(name, 0x60C2, sub, code, value))
    made.add_object(interpolation)
    _array(made, "Homing speeds", 0x6099, "I", (0, 0))
    _array(made, "Supported homing methods", 0x60E3, "b", HOMING_METHODS, access="ro")
    _array(made, "Store parameters", 0x1010, "I", (1, 1, 1))
    _array(made, "Restore default parameters", 0x1011, "I", (1, 1, 1))
    behaviour = od.ODArray("Error behaviour", 0x1029)
    behaviour.add_member(_entry("Entries", 0x1029, 0, "B", 1, access="ro"))
    behaviour.add_member(_entry("Communication error", 0x1029, 1, "B", 0))
    made.add_object(behaviour)
    for pdo in PDOS.values():
        _pdo(made, pdo.parameters, pdo.cob + node)
    return made


def _variable(
    made: od.ObjectDictionary, name: str, index: int, code: str, value: int, *, access: str = "rw"
) -> None:
    made.add_object(_entry(name, index, 0, code, value, access=access))


def _array(
    made: od.ObjectDictionary,
    name: str,
    index: int,
    code: str,
    values: tuple[int, ...],
    *,
    access: str = "rw",
) -> None:
    array = od.ODArray(name, index)
    array.add_member(_entry("Entries", index, 0, "B", len(values), access="ro"))
    for sub, value in enumerate(values, 1):
        array.add_member(_entry(f"{name} {sub}", index, sub, code, value, access=access))
    made.add_object(array)


def _entry(
    name: str, index: int, sub: int, code: str, value: int, *, access: str = "rw"
) -> od.ODVariable:
    entry = od.ODVariable(name, index, sub)
    entry.data_type = _TYPES[code]
    entry.access_type = access
    entry.default = value
    low = -(2 ** (8 * struct.calcsize(code) - 1)) if code.islower() else 0
    entry.min, entry.max = low, low + 2 ** (8 * struct.calcsize(code)) - 1
    return entry


def _pdo(made: od.ObjectDictionary, index: int, cob: int) -> None:
    parameters = od.ODRecord("PDO parameters", index)
    rows = (("Entries", "B", 5), ("COB-ID", "I", 0x80000000 | cob), ("Type", "B", 255))
    for sub, (name, code, value) in enumerate(rows):
        parameters.add_member(_entry(name, index, sub, code, value))
    parameters.add_member(_entry("Event timer", index, 5, "H", 0))
    made.add_object(parameters)
    mapping = od.ODArray("PDO mapping", index + 0x200)
    mapping.add_member(_entry("Entries", index + 0x200, 0, "B", 0))
    for sub in range(1, 9):
        mapping.add_member(_entry(f"Object {sub}", index + 0x200, sub, "I", 0))
    made.add_object(mapping)
