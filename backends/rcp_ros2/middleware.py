"""Check in another process that the middleware selected by the environment can be loaded.

rcl checks it when its library is loaded, and ends the process with code 102 if it differs from
`RMW_IMPLEMENTATION`: in C, so that no exception handler runs.
"""

from __future__ import annotations

import os
import subprocess
import sys

from rcp_kernel.errors import ConfigError, NotReady

__all__ = ["check_middleware"]

_NAMES = ("RMW_IMPLEMENTATION", "RCL_ASSERT_RMW_ID_MATCHES")
_LOADS = 10.0  # s to import rclpy on a slow machine


def check_middleware() -> None:
    """Import rclpy in another process first; blocks, so called in a worker thread.

    :raises ConfigError: the environment selects a middleware that is not available.
    :raises NotReady: that could not be determined in time.
    """
    requested = " ".join(f"{name}={os.environ[name]}" for name in _NAMES if os.environ.get(name))
    if not requested or "rclpy" in sys.modules:
        return
    try:
        found = subprocess.run(
            [sys.executable, "-c", "import rclpy"],
            capture_output=True,
            text=True,
            timeout=_LOADS,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise NotReady(f"cannot determine whether {requested} can be loaded: {error}") from None
    if found.returncode:
        lines = [line for line in found.stderr.splitlines() if line.strip()]
        why = lines[-1].strip() if lines else f"exit code {found.returncode}"
        raise ConfigError(
            f"the ROS 2 middleware selected by the environment ({requested}) cannot be loaded: {why}; "
            "install it, or unset the variable"
        )
