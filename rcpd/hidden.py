"""What a robot must not say of a proposed file: its reasons travel through a hub, which records them.

The kernel's own messages show no values of such a file. Those of plugins do, in whatever form.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

__all__ = ["Hidden"]

_WORD = re.compile(r"[^\W_]+")
_SHORT = 3  # characters; a shorter secret could be in any message
_WORDY = 5  # characters; shorter words of a secret ("admin-of-the-kit") are in many messages
_LONG = 8  # characters of what does not appear in a message by chance, as a part of other words


class Hidden:
    """The secrets of a file: values from the environment and other files, and those that keys call secret."""

    def __init__(self, text: str, found: Iterable[str]) -> None:
        secrets = [secret.casefold() for secret in found]
        rest = text.casefold()
        for secret in secrets:  # what the file shows elsewhere too is none
            rest = rest.replace(secret, " ", 1)
        words = {word for secret in secrets for word in _WORD.findall(secret)}
        words -= set(_WORD.findall(rest))
        self._words = {
            word for word in words if len(word) >= (_SHORT if word in secrets else _WORDY)
        }
        self._parts = {
            part
            for part in (*words, *secrets)
            if len(part) >= _LONG and part not in rest  # a word may be a part of others there
        }

    def reason(self, message: str, source: str) -> str:
        """Return a message, or one that only says where to read it."""
        folded = message.casefold()
        shown = not self._words.isdisjoint(_WORD.findall(folded))
        if not shown and not any(part in folded for part in self._parts):
            return message
        return (
            f"{source}: refused for a reason that contains a value from the environment or a "
            "secret of the file; `rcpd check` with this file on the robot shows it"
        )
