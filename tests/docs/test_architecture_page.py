"""Each file that the architecture page names exists, and contains what the page says is in it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
SOURCES = ("", "transports", "plugins", "backends", "clients/python")
NAMED = re.findall(r"`((?:\w+/)+\w+\.py)`((?:(?: |, | and )`[A-Za-z_][\w.]*`)*)", PAGE)


def names_in(file: Path) -> set[str]:
    """Return functions, classes and methods, the last as `Class.method`."""
    found: set[str] = set()
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            methods = (
                item
                for item in node.body
                if isinstance(item, (ast.FunctionDef, ast.AsyncFunctionDef))
            )
            found |= {name for item in methods for name in (item.name, f"{node.name}.{item.name}")}
    return found


@pytest.mark.parametrize(("path", "names"), NAMED)
def test_a_place_that_the_page_names_is_there(path: str, names: str) -> None:
    files = [file for source in SOURCES if (file := ROOT / source / path).is_file()]
    assert files, f"there is no {path}"
    missing = set(re.findall(r"`([^`]+)`", names)) - names_in(files[0])
    assert not missing, f"{path} has no {missing}"


def test_the_page_names_places() -> None:
    assert len(NAMED) > 30
