"""Check that the built wheels have only packages of ours at their top level, all of them, and the files beside their code."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).parent.parent
_DASHBOARD = "rcp_dashboard/"
_BUILT = ("index.html.gz", "licenses.md")
_RUNTIME = "rcp_client/codegen/runtime/"
_FOLDERS = {
    "rcp_client": ("clients/python",),
    "rcp_gateway": (".", "transports", "plugins", "backends"),
}
"""Where the packages of each distribution lie."""


def expected(distribution: str) -> set[str]:
    """List the packages of a distribution."""
    folders = [ROOT / name for name in _FOLDERS[distribution]]
    return {path.parent.name for folder in folders for path in folder.glob("rcp*/__init__.py")}


def runtime() -> set[str]:
    """List the files of other languages that `rcpctl codegen` writes."""
    folder = ROOT / "clients/python"
    found = (folder / _RUNTIME).glob("*/*.*")
    return {path.relative_to(folder).as_posix() for path in found if path.suffix != ".pyc"}


def check(wheel: Path) -> str | None:
    """Compare a wheel with the tree; return what is wrong with it."""
    distribution = wheel.name.partition("-")[0]
    names = zipfile.ZipFile(wheel).namelist()
    found = {name.split("/")[0] for name in names}
    packages = {name for name in found if not name.endswith(".dist-info")}
    if packages != expected(distribution):
        return f"has {sorted(packages)}, expected {sorted(expected(distribution))}"
    if distribution == "rcp_gateway":
        pages = [name for name in names if name.startswith(_DASHBOARD + "static/")]
        sources = [name for name in names if name.startswith(_DASHBOARD + "web/")]
        if not {_DASHBOARD + f"static/{name}" for name in _BUILT} <= set(pages) or sources:
            return f"has {len(pages)} files of the dashboard and its sources {sources}"
        if twice := [name for name in pages if name + ".gz" in pages]:
            return f"has {len(twice)} pages compressed and as they were"
    if distribution == "rcp_client" and not (wanted := runtime()) <= set(names):
        return f"lacks {sorted(wanted - set(names))}"
    print(f"{wheel.name}: {len(names)} files in {', '.join(sorted(packages))}")
    return None


def main() -> int:
    """Check the wheels of the folder that is named."""
    wheels = sorted(Path(sys.argv[1]).glob("*.whl"))
    if [wheel.name.partition("-")[0] for wheel in wheels] != sorted(_FOLDERS):
        print(f"there are {[wheel.name for wheel in wheels]}, expected {sorted(_FOLDERS)}")
        return 1
    faults = {wheel.name: check(wheel) for wheel in wheels}
    for name, fault in faults.items():
        if fault is not None:
            print(f"{name} {fault}")
    return int(any(faults.values()))


if __name__ == "__main__":
    sys.exit(main())
