"""Run `rcpd check --json FILE` once for each module named after it, as if that were not installed."""

from __future__ import annotations

import os
import sys
import traceback
from importlib.machinery import ModuleSpec, PathFinder

from rcpd.cli import main  # before anything is hidden, and in every child


class Without(PathFinder):
    """Finds what is installed but for one module."""

    hidden = ""

    @classmethod
    def find_spec(cls, fullname, path=None, target=None) -> ModuleSpec | None:  # noqa: ANN001
        if fullname == cls.hidden or fullname.startswith(f"{cls.hidden}."):
            return None
        return super().find_spec(fullname, path, target)


file, *modules = sys.argv[1:]
sys.meta_path = [Without if one is PathFinder else one for one in sys.meta_path]
for Without.hidden in modules:
    if (child := os.fork()) == 0:
        try:
            main(["check", "--json", file], standalone_mode=False)
        except SystemExit:
            pass
        except BaseException:
            traceback.print_exc()
        sys.stdout.flush()
        os._exit(0)
    os.waitpid(child, 0)
    sys.stdout.write("\0")
    sys.stdout.flush()
