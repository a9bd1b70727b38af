"""Meshes and textures of a robot's description, for viewers without its files."""

from __future__ import annotations

import asyncio
import html
import re
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceRejected,
    DeviceTimeout,
    InvalidValue,
    PayloadTooLarge,
)
from rcp_kernel.model import READS, Resource
from rcp_kernel.spi import Progress
from rcp_ros2.binding import Binding, Offer, Shared, common
from rcp_ros2.config import Assets as AssetsConfig
from rcp_ros2.config import Mapping, Qos
from rcp_ros2.graph import Graph

__all__ = ["MEDIA", "Assets", "find", "packages_of"]

_STRING = "std_msgs/msg/String"
_TOPIC = "/robot_description"
_LATCHED = Qos(depth=1)
MEDIA = {
    ".stl": "model/stl",
    ".dae": "model/vnd.collada+xml",
    ".obj": "model/obj",
    ".mtl": "model/mtl",
    ".glb": "model/gltf-binary",
    ".gltf": "model/gltf+json",
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
}
"""Supported file name extensions with their media types."""
_NAMED = re.compile(r"""=\s*["']\s*package://([A-Za-z][A-Za-z0-9_-]*)/""")
_URI = re.compile(r"package://([A-Za-z][A-Za-z0-9_-]*)/([^\x00-\x1f\\]+)")


class Fetch(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The requested file."""

    uri: Annotated[
        str,
        Meta(
            min_length=1,
            max_length=1024,
            description="URI from the robot's description, or from a file that it refers to: "
            "package://my_robot/meshes/base.stl.",
        ),
    ]


class Asset(msgspec.Struct, frozen=True):
    """A file."""

    media_type: str
    data: bytes


def packages_of(description: str) -> frozenset[str]:
    """Return the packages that a robot's description refers to."""
    return frozenset(_NAMED.findall(html.unescape(description)))


def find(uri: str, packages: Iterable[str], config: AssetsConfig) -> Path:
    """Return the file of a `package://` URI, within the folder of one of `packages`.

    :raises InvalidValue: the URI, its package or its file type is not allowed.
    :raises AdapterUnavailable: the package is not on this machine.
    :raises DeviceRejected: there is no such file in the package's folder.
    :raises PayloadTooLarge: it is larger than the configuration allows.
    """
    found = _URI.fullmatch(uri)
    if found is None:
        raise _wrong(
            f"{uri!r} is not package://<package>/<file>", "Use a URI from the robot's description."
        )
    package, rest = found.groups()
    parts = rest.split("/")
    if not all(part.strip(". ") for part in parts):  # neither empty parts nor `.` and `..`
        raise _wrong(f"{uri!r} is not a plain path to a file", "Remove `.`, `..` and empty parts.")
    if package not in packages:
        named = ", ".join(sorted(packages)) or "none"
        raise _wrong(
            f"the robot's description does not refer to the package '{package}'",
            f"Request files of the packages in the description: {named}.",
        )
    if PurePosixPath(parts[-1]).suffix.lower() not in MEDIA:
        raise _wrong(
            f"'{parts[-1]}' is not a mesh or texture", f"Supported types: {', '.join(MEDIA)}."
        )
    return _within(_folder(package, config), rest, package, config.size)


def _within(folder: Path, rest: str, package: str, most: int) -> Path:
    """Return a file below a folder; symbolic links must not lead out of it."""
    try:
        file = (folder / rest).resolve(strict=True)
        there = file.is_relative_to(folder) and file.is_file()
        size = file.stat().st_size
    except (OSError, RuntimeError):  # missing, not readable, or a cycle of links
        there, size = False, 0
        file = folder
    if not there or file.suffix.lower() not in MEDIA:
        raise DeviceRejected(
            f"the package '{package}' has no file '{rest}'",
            remedy=f"Check its folder; if it consists of links, set the "
            f"folder with the files themselves in assets.paths.{package}.",
        )
    if size > most:
        raise PayloadTooLarge(
            f"'{rest}' has {size} bytes; the limit is {most}",
            remedy="Reduce the mesh, or raise `assets.size` of the backend.",
            details={"size": size, "limit": most},
        )
    return file


def _folder(package: str, config: AssetsConfig) -> Path:
    named = config.paths.get(package)
    try:
        if named is None:
            from ament_index_python.packages import get_package_share_directory

            named = get_package_share_directory(package)
        return Path(named).resolve(strict=True)
    except (ImportError, LookupError, ValueError, OSError) as error:
        raise AdapterUnavailable(
            f"the package '{package}' is not on the gateway's machine: {error}",
            remedy=f'Install it there, or set the folder of its files: assets.paths.{package} = "…".',
        ) from None


def _wrong(message: str, remedy: str) -> InvalidValue:
    return InvalidValue(message, remedy=remedy, details={"pointer": "/uri"})


class Assets:
    """Provides the files of each robot description that is mapped or exposed."""

    def __init__(self, shared: Shared, matters: Callable[[str], bool]) -> None:
        self._shared = shared
        self._matters = matters

    def find(self, graph: Graph) -> dict[str, Offer]:
        """Return a service for each description in the graph."""
        found: dict[str, Offer] = {}
        for topic, type_ in graph.topics.items():
            if topic.endswith(_TOPIC) and type_ == _STRING and self._matters(topic):
                space = topic.removesuffix(_TOPIC)
                name = self._shared.naming.path("service", f"{space}/assets/fetch")
                mapping = Mapping(topic=topic)
                found[name] = Offer(mapping, partial(Fetching, self._shared, name, mapping))
        return found


class Fetching(Binding):
    """The file service of one description."""

    def __init__(self, shared: Shared, name: str, mapping: Mapping) -> None:
        self._packages: frozenset[str] | None = None
        """Packages that the description refers to; None before it was received."""
        self._follows = False
        self._key = f"{mapping.target} assets"
        text = f"Return a mesh or texture of a package that {mapping.target} refers to"
        facts = common(name, mapping, text, topic=mapping.topic, **READS)
        super().__init__(shared, Resource(input=Fetch, output=Asset, **facts), mapping)

    def _follow(self) -> None:
        if not self._follows:
            self._follows = True
            self.shared.ros.post(
                self.shared.listen,
                self.mapping.target,
                _STRING,
                self._key,
                self._described,
                _LATCHED,
            )

    def _described(self, text: Any) -> None:
        self._packages = packages_of(text.data)

    async def execute(self, value: Any, progress: Progress) -> Asset:
        """Return a file; the first call subscribes to the description.

        :raises DeviceTimeout: no description is received.
        """
        self._follow()
        patience = self.shared.settling + self.timeout
        if not await self.shared.until(lambda: self._packages is not None, patience):
            raise DeviceTimeout(
                f"no {self.mapping.target} received within {patience:.1f} s",
                remedy="Start the node that publishes it, for example robot_state_publisher.",
            )
        packages = self._packages or ()
        file = await asyncio.to_thread(find, value.uri, packages, self.shared.config.assets)
        data = await asyncio.to_thread(_read, file, self.shared.config.assets.size)
        return Asset(MEDIA[file.suffix.lower()], data)

    def close(self) -> None:
        """Unsubscribe from the description."""
        if self._follows:
            self.shared.ros.post(self.shared.subscriptions.untap, self.mapping.target, self._key)


def _read(file: Path, most: int) -> bytes:
    with file.open("rb") as opened:
        data = opened.read(most + 1)
    if len(data) > most:
        raise PayloadTooLarge(f"'{file.name}' has grown beyond {most} bytes")
    return data
