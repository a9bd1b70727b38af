"""Read the tables of the documentation."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
_MADE = ("build", "dist")


def every_page() -> list[Path]:
    """Return all pages of the repository, those of packages and examples too."""
    folders = [path for path in ROOT.iterdir() if path.is_dir() and path.name[0] != "."]
    found = [*ROOT.glob("*.md"), *(ROOT / ".github").rglob("*.md")]
    for folder in folders:
        if folder.name not in _MADE:
            found += folder.rglob("*.md")
    return sorted(
        path for path in found if not {*path.relative_to(ROOT).parts} & {"node_modules", "static"}
    )


def section(page: Path, heading: str) -> str:
    """Return the text below a heading, up to the next heading."""
    text = page.read_text(encoding="utf-8")
    found = re.search(rf"^#+ {re.escape(heading)}$(.*?)(?=^#+ |\Z)", text, re.MULTILINE | re.DOTALL)
    assert found is not None, f"{page.name} has no heading {heading!r}"
    return found[1]


def rows(text: str) -> list[list[str]]:
    """Return the cells of a table's rows whose first cell is code."""
    lines = [line for line in text.splitlines() if line.startswith("| `")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


def keys(text: str) -> list[str]:
    """Return the names in the first cells of a table."""
    return [name for row in rows(text) for name in re.findall(r"`([^`]+)`", row[0])]
