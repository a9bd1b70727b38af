"""One update of a view, computed once for all of its readers to whom it is the same."""

from __future__ import annotations

from collections.abc import Generator, Hashable
from typing import Any

__all__ = ["SharedUpdate"]


class _Value:
    """A value that its readers compute together: each step serves all of them."""

    def __init__(self, steps: Generator[None, None, Any]) -> None:
        self._steps = steps
        self._done = False
        self._value: Any = None
        self._error: Exception | None = None

    def wait(self) -> Generator[None, None, Any]:
        """Compute the value, in the turns of whichever reader has one, so that none waits for another."""
        while not self._done:
            try:
                next(self._steps)
            except StopIteration as end:
                self._done, self._value = True, end.value
            except Exception as error:  # each reader reports it
                self._done, self._error = True, error
            else:
                yield
        if self._error is not None:
            raise self._error
        return self._value


class SharedUpdate:
    """The values of one update, by what determines them.

    Only the subscribers that the update reaches hold it: a later one is shown what holds then.
    """

    __slots__ = ("__weakref__", "_values", "seq")

    def __init__(self, seq: int) -> None:
        self.seq = seq
        """The number of the sample that announced it."""
        self._values: dict[Hashable, _Value] = {}

    def make(self, key: Hashable, steps: Generator[None, None, Any]) -> Generator[None, None, Any]:
        """Return the value for a key, computed by `steps` unless another reader has begun it.

        The first step is taken at once, while what the key says of the reader holds.
        """
        value = self._values.setdefault(key, _Value(steps))
        return (yield from value.wait())
