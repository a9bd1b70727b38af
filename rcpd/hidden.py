"""What a robot must not say of a proposed file: its reasons travel through a hub, which records them.

The kernel's own messages show no values of such a file. Those of plugins do, in whatever form.
"""

from __future__ import annotations

import re

from rcp_kernel.config.file import secrets_of

__all__ = ["Hidden"]

_WORD = re.compile(r"[^\W_]+")
_SHORT = 3  # characters of a word that could be in any message


class Hidden:
    """The secrets of a file: its values from the environment, and those that keys call secret."""

    def __init__(self, text: str) -> None:
        secrets = secrets_of(text)
        rest = text.casefold()
        for secret in secrets:  # what the file shows elsewhere too is none
            rest = rest.replace(secret.casefold(), " ", 1)
        shown = set(_WORD.findall(rest))
        words = (word for secret in secrets for word in _WORD.findall(secret.casefold()))
        self._words = {word for word in words if len(word) >= _SHORT} - shown
        folded = {secret.casefold() for secret in secrets if len(secret) >= _SHORT}
        self._whole = {secret for secret in folded if secret not in rest}

    def reason(self, message: str, source: str) -> str:
        """Return a message, or one that only says where to read it."""
        folded = message.casefold()
        if not any(secret in folded for secret in (*self._words, *self._whole)):
            return message
        return (
            f"{source}: refused for a reason that contains a value from the environment or a "
            "secret of the file; `rcpd check` with this file on the robot shows it"
        )
