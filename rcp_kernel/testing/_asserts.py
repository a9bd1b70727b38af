"""Register the suites for pytest's assert rewriting; imported before them."""

from __future__ import annotations

try:
    import pytest
except ImportError as error:
    raise ImportError("rcp_kernel.testing needs pytest: pip install pytest") from error

pytest.register_assert_rewrite(
    "rcp_kernel.testing.backend", "rcp_kernel.testing.stop", "rcp_kernel.testing.wire"
)
