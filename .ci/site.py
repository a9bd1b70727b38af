"""Hooks of MkDocs: pages link to files of the repository, which the site therefore has too."""

from __future__ import annotations

import logging
import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
_log = logging.getLogger("mkdocs.hooks.site")  # `--strict` counts the warnings of `mkdocs.…`
_LINK = re.compile(r"(\]\()([^)#\s]+)((?:#[^)\s]*)?\))")
_ELSEWHERE = re.compile(r"[a-z+]+:|/")
_FOLDER = "repository"
_real: dict[str, Path] = {}
"""Where pages come from, by their place in the site."""


def _target(link: str, page: Path) -> Path | None:
    """Return the file of the repository outside of `docs/` that a link of a page leads to."""
    if _ELSEWHERE.match(link):
        return None
    found = (page.parent / link).resolve()
    if found.is_dir():
        found = next((found / name for name in ("README.md",) if (found / name).exists()), found)
    outside = found.is_relative_to(ROOT) and not found.is_relative_to(DOCS)
    return found if outside and found.is_file() else None


def _place(path: Path) -> str:
    if path.is_relative_to(DOCS):
        return path.relative_to(DOCS).as_posix()
    if path == ROOT / "README.md":
        return "index.md"
    return f"{_FOLDER}/{path.relative_to(ROOT).as_posix()}"


def on_files(files: Files, *, config: Any) -> Files:
    """Add the README as the first page, and all files that pages link to, until none is missing."""
    _real.clear()
    _real.update({file.src_uri: DOCS / file.src_uri for file in files.documentation_pages()})
    waiting = [ROOT / "README.md", *_real.values()]
    _real["index.md"] = ROOT / "README.md"
    _add(files, ROOT / "README.md", config)
    while waiting:
        page = waiting.pop()
        for _, link, _ in _LINK.findall(page.read_text(encoding="utf-8")):
            target = _target(link, page)
            if target is None or files.get_file_from_path(_place(target)) is not None:
                continue
            _add(files, target, config)
            if target.suffix == ".md":
                _real[_place(target)] = target
                waiting.append(target)
    return files


def _add(files: Files, path: Path, config: Any) -> None:
    files.append(File.generated(config, _place(path), abs_src_path=str(path)))


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Let links lead to where the files are in the site."""
    real = _real.get(page.file.src_uri)
    if real is None:
        return markdown
    here = posixpath.dirname(page.file.src_uri)

    def moved(link: re.Match[str]) -> str:
        if _ELSEWHERE.match(link[2]):
            return link[0]
        target = (real.parent / link[2]).resolve()
        if target.is_dir():
            readme = target / "README.md"
            target = readme if readme.exists() else target
        if not (target.exists() and target.is_relative_to(ROOT)):
            if real.is_relative_to(DOCS) and target.is_relative_to(DOCS):
                return link[0]  # MkDocs tells of it
            _log.warning("%s links to %s, which is not there", real.relative_to(ROOT), link[2])
        if not target.is_file():  # a folder, of which the site has no page
            return f"]({link[3][:-1] or '#'})"
        return f"{link[1]}{posixpath.relpath(_place(target), here or '.')}{link[3]}"

    return _LINK.sub(moved, markdown)
