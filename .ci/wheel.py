"""Check that a built wheel has only packages of ours at its top level, all of them, and the pages."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).parent.parent
_DASHBOARD = "rcp_dashboard/"
_BUILT = ("index.html", "licenses.md")


def expected() -> set[str]:
    """List the packages of the tree."""
    folders = [ROOT, *(ROOT / name for name in ("transports", "plugins", "backends"))]
    return {path.parent.name for folder in folders for path in folder.glob("rcp_*/__init__.py")}


def main() -> int:
    """Compare the one wheel of the folder that is named with the tree."""
    (wheel,) = Path(sys.argv[1]).glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    found = {name.split("/")[0] for name in names}
    packages = {name for name in found if not name.endswith(".dist-info")}
    if packages != expected():
        print(f"top level of {wheel.name}: {sorted(packages)}, expected {sorted(expected())}")
        return 1
    pages = [name for name in names if name.startswith(_DASHBOARD + "static/")]
    sources = [name for name in names if name.startswith(_DASHBOARD + "web/")]
    if not {_DASHBOARD + f"static/{name}" for name in _BUILT} <= set(pages) or sources:
        print(f"{wheel.name} has {len(pages)} files of the dashboard and its sources {sources}")
        return 1
    print(f"{wheel.name}: {len(names)} files in {', '.join(sorted(packages))}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
