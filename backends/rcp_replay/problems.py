"""What is wrong with a replay, until it is over."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["Problems"]


class Problems:
    """Reports the problem that began first, and None once there is none."""

    def __init__(self, report: Callable[[str | None], None]) -> None:
        self._report = report
        self._found: dict[str, str] = {}
        self._told: str | None = None

    def begin(self, what: str, reason: str) -> None:
        """Note what is wrong with something, instead of what was before."""
        self._found[what] = reason
        self._tell()

    def end(self, what: str) -> None:
        """Note that nothing is wrong with something any more."""
        if self._found.pop(what, None) is not None:
            self._tell()

    def _tell(self) -> None:
        told = next(iter(self._found.values()), None)
        if told != self._told:
            self._told = told
            self._report(told)
