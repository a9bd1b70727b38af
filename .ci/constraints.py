"""Write `constraints.txt`: what this environment holds, name and version, without any address.

Run as `make constraints` after a change of the requirements, in an environment that passes.
"""

from __future__ import annotations

import re
from importlib.metadata import distributions
from pathlib import Path

HEAD = """\
# Versions that pass the tests together; `make` installs with them. Written by `make constraints`.
"""


def pins() -> list[str]:
    """List what pip installed, but for this project and the tools that every environment has."""
    found: dict[str, str] = {}
    for dist in distributions():
        name = re.sub(r"[-_.]+", "-", dist.name).lower()
        # The ros-* wheels carry metadata of packages inside them, which no index has.
        installed = (dist.read_text("INSTALLER") or "").strip()
        if name in {"rcp-client", "rcp-gateway", "pip", "setuptools"} or not installed:
            continue
        if dist.read_text("direct_url.json") is None:
            found[name] = dist.version
    return [f"{name}=={version}" for name, version in sorted(found.items())]


if __name__ == "__main__":
    Path("constraints.txt").write_text(HEAD + "\n".join(pins()) + "\n", encoding="utf-8")
