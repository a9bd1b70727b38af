"""A part of the tree for e-stops and control: a tenant, a sub-tree, or a robot.

The part of a robot extends over every branch.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator

from rcp_kernel.contract.paths import can_name_resource, names_of
from rcp_kernel.errors import InvalidPath
from rcp_kernel.model import BRANCHES, parse_path
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.registry import Registry

__all__ = ["Scope"]

_AFTER = chr(ord("/") + 1)  # ends what begins with a path and a "/" in a sorted list


class Scope:
    """A sub-tree of one tenant, by whole segments.

    :raises InvalidPath: the text is none.
    """

    __slots__ = ("_below", "robot", "tenant", "text")

    def __init__(self, text: str, tenant: str | None = None) -> None:
        self.text = parse_path(text, tenant)
        """The scope with its tenant written out."""
        _, root, *segments = self.text.split("/")
        if root != "tenant" or not segments:
            raise _bad(text)
        self.tenant, *below = segments
        self.robot: str | None = None
        """The robot, in every branch; None for a sub-tree of one branch or all."""
        if below and below[0] not in BRANCHES:
            if len(below) > 1:
                raise _bad(text)
            self.robot = below[0]
        self._below = self.text + "/"

    @property
    def whole(self) -> bool:
        """Whether it is all of its tenant."""
        return self.text.count("/") == 2

    def covers(self, path: str) -> bool:
        """Return whether a full path lies in the scope, whether or not it exists."""
        if self.robot is None:
            return path == self.text or path.startswith(self._below)
        return names_of(path, self.tenant)[:1] == [self.robot]

    def overlaps(self, other: Scope) -> bool:
        """Return whether a path, existing or future, may lie in both."""
        if self.tenant != other.tenant:
            return False
        if self.robot is not None and other.robot is not None:
            return self.robot == other.robot
        if self.robot is None and other.robot is None:
            return self.covers(other.text) or other.covers(self.text)
        robot, tree = (self, other) if self.robot is not None else (other, self)
        # A whole branch may hold a part of any robot; what lies deeper names the robot it is of.
        return not can_name_resource(tree.text) or robot.covers(tree.text)

    def entries(self, registry: Registry) -> Iterator[Entry]:
        """Iterate over the resources in the scope; iteration in steps may miss new ones."""
        if self.robot is None:
            starts = [self.text]
        else:
            starts = [f"/tenant/{self.tenant}/{branch}/{self.robot}" for branch in sorted(BRANCHES)]
        index, entries = registry.index, registry.entries
        for start in starts:
            if (entry := entries.get(start)) is not None:
                yield entry
            first = bisect_left(index, f"{start}/")
            for place in range(first, bisect_left(index, f"{start}{_AFTER}", first)):
                if (entry := entries.get(index[place])) is not None:
                    yield entry

    def __repr__(self) -> str:
        return f"Scope({self.text!r})"


def _bad(text: str) -> InvalidPath:
    return InvalidPath(
        f"{text[:80]!r} is not a scope",
        remedy="Use a tenant (/tenant/<tenant>), a sub-tree of a branch "
        "(/tenant/<tenant>/actuator/…) or a robot (/tenant/<tenant>/<robot>).",
    )
