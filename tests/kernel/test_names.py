"""What plugins import from the kernel is what the contract has, whole."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import pytest


@pytest.mark.parametrize("name", ["clock", "errors", "model", "types", "values", "wire"])
def test_the_kernel_names_the_whole_contract(name: str) -> None:
    contract: Any = import_module(f"rcp_protocol.{name}")
    kernel: Any = import_module(f"rcp_kernel.{name}")
    assert set(contract.__all__) <= set(kernel.__all__)
    own = {"Clock", "SYSTEM_CLOCK"} if name == "clock" else set[str]()
    named = set(kernel.__all__) - own
    assert all(getattr(kernel, each) is getattr(contract, each) for each in named)
