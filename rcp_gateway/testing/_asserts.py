"""Register the suites for pytest's assert rewriting; imported before them."""

from __future__ import annotations

try:
    import pytest
except ImportError as error:
    raise ImportError("rcp_gateway.testing needs pytest: pip install pytest") from error

pytest.register_assert_rewrite(
    "rcp_gateway.testing.backend", "rcp_gateway.testing.stop", "rcp_gateway.testing.wire"
)
