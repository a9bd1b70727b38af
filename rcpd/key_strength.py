"""Rough estimate of the entropy of plain-text keys.

Throttling does not lock out valid keys, so only its entropy protects a key from being guessed.
Words, repetitions and sequences count little; random-looking characters count fully.
"""

from __future__ import annotations

import math
import re
import string
from collections.abc import Iterable
from itertools import pairwise

import structlog

from rcp_kernel.config.identity import KeyConfig

__all__ = ["entropy", "log_weak_keys", "weak_keys"]

log = structlog.get_logger("rcp.identity")
_ENOUGH = 64.0  # bits: three million years at 100,000 guesses a second
_WORD = 13.0  # bits of a word: one of 8,000
_LETTER = 2.0  # bits of each letter of a text, about
_DIGIT = math.log2(10)
_SEQUENCE = 4.0  # bits
_CLASSES = (string.ascii_lowercase, string.ascii_uppercase, string.digits)
_HEX = re.compile(r"[0-9a-f-]+|[0-9A-F-]+")
_RUN = re.compile(r"[A-Z]?[a-z]+|[A-Z]+|[0-9]+|[^A-Za-z0-9]+")
_TEXT = re.compile(r"[A-Z]?[a-z]+|[A-Z]+")


def weak_keys(keys: Iterable[KeyConfig]) -> list[str]:
    """Return the names of keys that are easy to guess; hashed keys cannot be judged."""
    return [one.name for one in keys if one.key is not None and entropy(one.key) < _ENOUGH]


def log_weak_keys(keys: Iterable[KeyConfig], source: str) -> None:
    """Log the number of weak keys; readers of the log must not learn their names."""
    weak = weak_keys(keys)
    if weak:
        log.warning("weak_keys", keys=len(weak), remedy=f"`rcpd check {source}` names them")


def entropy(key: str) -> float:
    """Estimate the entropy in bits."""
    key = key[: (key + key).find(key, 1)]  # of what repeats itself, one round
    symbols = set(re.sub("[A-Za-z0-9]", "", key))
    if len(symbols) > 1:
        return _of_runs(key, _letter_bits(key, len(symbols)))
    each = _letter_bits(key, 0)
    parts = set(re.split("[^A-Za-z0-9]+", key)) - {""}
    return sum(_of_word(part) if _TEXT.fullmatch(part) else _of_runs(part, each) for part in parts)


def _letter_bits(key: str, symbols: int) -> float:
    """Return the bits of one letter, had all that are like it been as likely."""
    if _HEX.fullmatch(key):
        return 4.0
    alphabet = sum(len(letters) for letters in _CLASSES if not set(letters).isdisjoint(key))
    return math.log2(max(2, alphabet + symbols))


def _of_word(text: str) -> float:
    return _LETTER * len(text) if len(text) < 4 else max(_WORD, _LETTER * len(text))


def _of_runs(text: str, each: float) -> float:
    runs: list[str] = _RUN.findall(text)
    known = {run for run in runs if len(run) > 2}  # repeated words add no entropy
    return sum(_of_run(run, each) for run in (*known, *(r for r in runs if r not in known)))


def _of_run(run: str, each: float) -> float:
    """Estimate a run of letters of one case, of digits or of symbols."""
    full = each * len(run)
    if len(run) < 4:
        return full
    if run.isdigit():
        steps = {ord(after) - ord(before) for before, after in pairwise(run)}
        return _SEQUENCE if len(steps) == 1 else _DIGIT * len(run)
    return min(full, _of_word(run)) if run.isalpha() else full
