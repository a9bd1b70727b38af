"""On-board files, in memory: logs, uploaded files, and files that ArduPilot generates when read."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from urllib.parse import parse_qs

from rcp_mavlink_sim.flightlog import FlightLog
from rcp_mavlink_sim.parameters import Parameters
from rcp_mavlink_sim.parameters_table import CASTS, table

__all__ = ["Files"]

_LOGS, _PICTURES = "APM/LOGS", "DCIM"
_ROLL = 20  # pictures that are kept
_MOST = 4 << 20  # bytes, limit of all uploaded files
_PACKED = 0x671B
_WITH_DEFAULTS = 0x671C


class Files:
    """Directories and files by path, without leading or trailing slashes; the root is empty."""

    def __init__(
        self, kind: str, params: Parameters, log: FlightLog, fixed: Mapping[str, bytes]
    ) -> None:
        """Hold those of one vehicle; `fixed` ones are part of its firmware."""
        self._kind, self._params, self._flights, self._fixed = kind, params, log, fixed
        self._stored: dict[str, bytearray] = {
            "@ROMFS/locations.txt": bytearray(
                b"#NAME=latitude,longitude,absolute-altitude,heading\n"
            )
        }
        self._folders = {"", "@PARAM", "@ROMFS", "@SYS", "APM", _LOGS, "APM/scripts", _PICTURES}
        above = {folder for path in fixed for folder in _folders_of(path)}
        self._folders |= above
        self._firmware = frozenset(above)

    def folder(self, path: str) -> bool:
        """Return whether a directory exists."""
        return path in self._folders

    def listed(self, path: str) -> list[tuple[str, int | None]]:
        """Return name and size of each entry of a directory; directories have no size."""
        start = f"{path}/" if path else ""
        found: dict[str, int | None] = {}
        for one in self._folders:
            if one and one.startswith(start) and "/" not in one[len(start) :]:
                found[one[len(start) :]] = None
        for one in [*self._stored, *self._made()]:
            if one.startswith(start) and "/" not in one[len(start) :]:
                content = self.read(one)
                found[one[len(start) :]] = len(content or b"")
        found.pop("", None)
        return sorted(found.items())

    def read(self, path: str) -> bytes | None:
        """Return the content of a file; None if it does not exist."""
        plain, _, query = path.partition("?")
        if plain == "@PARAM/param.pck" and self._kind != "px4":
            return self._packed(query)
        if plain == "@SYS/uarts.txt":
            return b"UARTV1\nSERIAL0 OTG1\n"
        if plain.startswith(f"{_LOGS}/"):
            return self._log(plain)
        if path in self._fixed:
            return self._fixed[path]
        stored = self._stored.get(path)
        return None if stored is None else bytes(stored)

    def write(self, path: str, offset: int, data: bytes) -> bool:
        """Write to a created file; return whether there is space."""
        content = self._stored[path]
        used = sum(map(len, self._stored.values()))
        if used + max(0, offset + len(data) - len(content)) > _MOST:
            return False
        content.extend(bytes(max(0, offset - len(content))))
        content[offset : offset + len(data)] = data
        return True

    def create(self, path: str) -> bool:
        """Create an empty file, replacing one of that name; return whether this succeeded."""
        folder, _, name = path.rpartition("/")
        if not name or path.startswith("@") or folder not in self._folders or path in self._folders:
            return False
        if folder in self._firmware:
            return False
        self._stored[path] = bytearray()
        return True

    def truncate(self, path: str, size: int) -> bool:
        """Truncate a file; return whether it exists."""
        if path not in self._stored:
            return False
        del self._stored[path][size:]
        return True

    def remove(self, path: str) -> bool:
        """Remove a file; return whether this succeeded."""
        return not path.startswith("@") and self._stored.pop(path, None) is not None

    def make_folder(self, path: str) -> bool:
        """Create a directory; return whether this succeeded."""
        parent, _, name = path.rpartition("/")
        taken = path in self._folders or path in self._stored
        if not name or path.startswith("@") or taken or parent not in self._folders:
            return False
        if parent in self._firmware:
            return False
        self._folders.add(path)
        return True

    def remove_folder(self, path: str) -> bool:
        """Remove an empty directory; return whether this succeeded."""
        if path not in self._folders or path.startswith("@") or not path or self.listed(path):
            return False
        self._folders.remove(path)
        return True

    def rename(self, old: str, new: str) -> bool:
        """Rename a file; return whether this succeeded."""
        if old not in self._stored or old.startswith("@") or self.exists(new):
            return False
        if not self.create(new):
            return False
        self._stored[new] = self._stored.pop(old)
        return True

    def store_picture(self, number: int, picture: bytes) -> str:
        """Store a picture in place of the oldest; return its path."""
        path = f"{_PICTURES}/{number:05d}.png"
        self._stored.pop(path, None)
        self._stored[path] = bytearray(picture)
        taken = [one for one in self._stored if one.startswith(f"{_PICTURES}/")]
        for oldest in taken[:-_ROLL]:
            del self._stored[oldest]
        return path

    def exists(self, path: str) -> bool:
        """Return whether a file or directory exists."""
        return path in self._folders or path in self._stored or path in self._made()

    def _made(self) -> list[str]:
        logs = [f"{_LOGS}/{number:08d}.BIN" for number in self._flights.logs]
        return ["@PARAM/param.pck", "@SYS/uarts.txt", *logs, *self._fixed]

    def _log(self, path: str) -> bytes | None:
        number = path.rpartition("/")[2].removesuffix(".BIN")
        log = self._flights.logs.get(int(number)) if number.isdigit() else None
        return None if log is None else bytes(log)

    def _packed(self, query: str) -> bytes:
        """Return the parameters in ArduPilot's packed format: names omit common prefixes."""
        options = {name: values[0] for name, values in parse_qs(query).items()}
        start, most = int(options.get("start", 0)), int(options.get("count", 0))
        defaults = options.get("withdefaults") == "1"
        params, usual = self._params, table(self._kind)
        names = params.listed()
        wanted = names[start : start + most if most else None]
        magic = _WITH_DEFAULTS if defaults else _PACKED
        out = bytearray(struct.pack("<HHH", magic, len(wanted), len(names)))
        last = ""
        for name in wanted:
            kind, default = usual[name]
            common = _common(last, name)
            number = "bhif".index(kind) + 1
            values = [params[name]]
            if defaults and default != params[name]:
                number |= 1 << 4
                values.append(default)
            out += bytes((number, common | (len(name) - common - 1) << 4))
            out += name[common:].encode()
            for value in values:
                out += struct.pack(f"<{kind}", CASTS[kind](value))
            last = name
        return bytes(out)


def _folders_of(path: str) -> list[str]:
    """Return the folders that a file is in, except the root."""
    parts = path.split("/")[:-1]
    return ["/".join(parts[: n + 1]) for n in range(len(parts))]


def _common(last: str, name: str) -> int:
    length = 0
    most = min(len(last), len(name) - 1, 15)
    while length < most and last[length] == name[length]:
        length += 1
    return length
