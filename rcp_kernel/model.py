"""`rcp_protocol.model`, under the name that plugins import."""

from __future__ import annotations

from rcp_protocol.model import (
    BRANCHES,
    MAX_DEEP,
    MAX_PATH,
    MOVING,
    READS,
    Kind,
    NativeType,
    Operation,
    Pattern,
    Policy,
    Resource,
    full_path,
    kind_of,
    operation_names,
    parse_path,
    tenant_of,
)

__all__ = [
    "BRANCHES",
    "MAX_DEEP",
    "MAX_PATH",
    "MOVING",
    "READS",
    "Kind",
    "NativeType",
    "Operation",
    "Pattern",
    "Policy",
    "Resource",
    "full_path",
    "kind_of",
    "operation_names",
    "parse_path",
    "tenant_of",
]
