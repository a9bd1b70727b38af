"""What can be run on a motor to set it up, beside its everyday commands."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Mapping
from typing import Any, Literal, NamedTuple

from rcp_kernel.spi import Progress

__all__ = ["Needs", "Procedure"]

Needs = Literal["enabled", "disabled", "connected"]
"""The state a motor must be in; `connected` is any, and the procedure only reads."""


def _accept(_value: Any) -> None:
    """Accept any input."""


class Procedure(NamedTuple):
    """One procedure of a motor or its drive, with the resource that runs it."""

    verb: str
    """The last segment of its path."""
    description: str
    run: Callable[[Any, Progress], Coroutine[Any, Any, Any]]
    needs: Needs
    motion: Literal["none", "set_points", "own"] = "none"
    """Whether it moves the motor: not, by set-points, or by the drive itself whatever its set-point is."""
    input: Any = None
    output: Any = None
    feedback: Any = None
    examples: tuple[Any, ...] = ()
    timeout: float = 10.0
    check: Callable[[Any], None] = _accept
    """Refuse an input that cannot be executed; also used by dry runs."""
    meta: Mapping[str, Any] = {}

    @property
    def branch(self) -> str:
        """The branch of its resource: what moves or tells how far it is is an action, the rest services."""
        return "service" if self.motion == "none" and self.feedback is None else "action"
