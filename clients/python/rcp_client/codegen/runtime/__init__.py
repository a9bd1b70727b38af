"""The parts of generated clients that are the same for every gateway, each in the language it is for."""

from __future__ import annotations

from importlib import resources

__all__ = ["runtime"]


def runtime(language: str, *names: str) -> str:
    """Return the text of files of a language, in this order."""
    folder = resources.files(__name__) / language
    texts = [(folder / name).read_text(encoding="utf-8").strip("\n") for name in names]
    return "\n\n".join(texts)
