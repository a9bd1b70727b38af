"""Real physics; without MuJoCo these tests are not collected."""

from __future__ import annotations

import importlib.util

if importlib.util.find_spec("mujoco") is None:
    collect_ignore_glob = ["test_*.py"]
else:
    from rcp_mujoco.opengl import choose_opengl

    choose_opengl()
