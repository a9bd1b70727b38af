"""Where the texts of types come from that are not installed: the configuration, its folders, or well-known ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path

from rcp_kernel.errors import ConfigError
from rcp_ros2.definitions import BadText, define_text
from rcp_ros2.idl import looking_in
from rcp_ros2.well_known import VERSIONS

__all__ = ["Texts"]


class Texts:
    """The texts of one backend."""

    def __init__(self, given: Mapping[str, str], folders: Iterable[str]) -> None:
        """Use the `given` texts, and the packages in `folders`: `<folder>/<package>/action/<Name>.action`.

        :raises ConfigError: there is no such folder.
        """
        self._given = given
        self._folders = [Path(folder) for folder in folders]
        for folder in self._folders:
            if not folder.is_dir():
                raise ConfigError(f"`interfaces`: there is no folder {folder}")
        for name, text in given.items():
            define_text(name, text)
        for name in VERSIONS:
            if "/msg/" in name and name not in given:
                self._define(name)

    def used(self) -> AbstractContextManager[None]:
        """Have types that are neither installed nor defined defined by their texts while entered."""
        return looking_in(self._define)

    def of(self, name: str, *, hashed: bool = True) -> Iterator[str]:
        """Yield the texts of a type, the best first: the oldest, if its server is from before hashes."""
        if name in self._given:
            yield self._given[name]
        package, group, leaf = name.split("/")
        for folder in self._folders:
            path = folder / package / group / f"{leaf}.{group}"
            if path.is_file():
                yield path.read_text()
        versions = VERSIONS.get(name, ())
        yield from versions if hashed else reversed(versions)

    def _define(self, name: str) -> bool:
        """Define a type that is loaded, if its text is there and right."""
        for text in self.of(name):
            try:
                define_text(name, text)
            except BadText:
                continue
            return True
        return False
