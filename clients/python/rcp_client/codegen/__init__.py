"""Typed clients generated from discovery."""

from __future__ import annotations

from rcp_client.codegen.go import write_go
from rcp_client.codegen.python import write_python
from rcp_client.codegen.rust import write_rust
from rcp_client.codegen.typescript import write_typescript
from rcp_client.messages import ResourceInfo

__all__ = ["generate"]

_WRITERS = {
    "go": write_go,
    "python": write_python,
    "rust": write_rust,
    "typescript": write_typescript,
}


def generate(language: str, resources: list[ResourceInfo], url: str) -> str:
    """Generate a module in `go`, `python`, `rust` or `typescript` for these resources."""
    return _WRITERS[language](resources, url)
