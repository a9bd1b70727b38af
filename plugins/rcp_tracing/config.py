"""The table `[features.tracing]`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_kernel.errors import ConfigError

__all__ = ["TracingConfig", "check"]


class TracingConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where spans are sent."""

    endpoint: str = "http://127.0.0.1:4318/v1/traces"
    """OTLP over HTTP, with protobuf."""
    headers: dict[str, str] = {}
    """Sent with each request; write secrets as `${file:PATH}` or `${NAME}`."""
    service: str = "rcp-gateway"
    """The name of the service in the traces."""
    ratio: Annotated[float, Meta(ge=0, le=1)] = 1.0
    """Share of traces that are exported; the same ones at all gateways with this ratio."""
    timeout: Annotated[float, Meta(gt=0, le=60)] = 5.0
    """Of one export, in s, also of the last one when the gateway stops."""


def check(config: TracingConfig) -> None:
    """Check the address.

    :raises ConfigError: it is none.
    """
    if not config.endpoint.startswith(("http://", "https://")):
        raise ConfigError("`endpoint` needs http:// or https://, and the path, as /v1/traces")
