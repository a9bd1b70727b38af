"""The configuration of `[plugins.a2a]`."""

from __future__ import annotations

from ipaddress import ip_address
from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_kernel.errors import ConfigError

__all__ = ["A2aConfig", "GrpcConfig", "Provider", "PushConfig", "check"]


class Provider(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The provider of the agent, for its card."""

    organization: Annotated[str, Meta(min_length=1)]
    url: Annotated[str, Meta(min_length=1)]


class PushConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Task notifications to addresses given by clients. Times in seconds."""

    enabled: bool = True
    http: bool = False
    """Whether addresses without TLS are allowed."""
    ca: str | None = None
    """A PEM file with CAs to trust in addition to the system's."""
    private: tuple[str, ...] = ()
    """Private networks (`10.0.5.0/24`) that may be called."""
    per_task: Annotated[int, Meta(ge=1, le=100)] = 8
    """Maximum number of addresses per task."""
    queue: Annotated[int, Meta(ge=1)] = 1000
    """Maximum number of queued notifications, over all tasks; the oldest are dropped."""
    attempts: Annotated[int, Meta(ge=1, le=20)] = 5
    timeout: Annotated[float, Meta(gt=0, le=60)] = 10.0
    """Time-out of one attempt."""
    backoff: Annotated[float, Meta(gt=0, le=60)] = 0.5
    """Delay before the second attempt; doubled before each further one."""


class GrpcConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The gRPC binding, on a port of its own."""

    host: Annotated[str, Meta(min_length=1)] = "127.0.0.1"
    port: Annotated[int, Meta(ge=0, le=65535)] = 50051
    url: Annotated[str, Meta(min_length=1)] | None = None
    """Address for the card, as `host:port`; default: `host` and `port`."""
    certificate: str | None = None
    """A PEM file with the certificate; required unless `host` is of this machine only."""
    key: str | None = None
    """A PEM file with its private key."""


class A2aConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The agent. Times in seconds."""

    name: str | None = None
    """Name of the agent; default: the gateway's."""
    description: str | None = None
    url: Annotated[str, Meta(pattern="^https?://[^/?#]+(/[^?#]*)?$")] | None = None
    """Public URL of the gateway; default: by the request's `Host`."""
    documentation: str | None = None
    provider: Provider | None = None
    card_key: str | None = None
    """A private key as PEM (P-256, RSA or Ed25519), or its file: signs the cards."""
    card_max_age: Annotated[int, Meta(ge=0)] = 60
    """Time for which a card may be cached."""
    compatible: bool = True
    """Whether to serve clients of A2A 0.3 as well."""
    old_card: bool = False
    """Whether cards also have the fields of 0.3, which 1.0 does not allow; not if they are signed."""
    message: Annotated[int, Meta(ge=1024)] = 1_048_576
    """Maximum request size, in bytes."""
    tasks_size: Annotated[int, Meta(ge=1024)] = 33_554_432
    """Maximum bytes of tasks per principal and tenant; the oldest ended ones are dropped."""
    tasks: Annotated[int, Meta(ge=1)] = 1000
    """Maximum number of tasks per principal and tenant; the oldest ended ones are dropped. New ones are
    refused while so many have not ended."""
    retention: Annotated[float, Meta(gt=0)] = 604_800.0
    """Time for which an ended task is kept."""
    input_timeout: Annotated[float, Meta(gt=0)] = 600.0
    """Time for which a task waits for an answer before it fails."""
    push: PushConfig = PushConfig()
    grpc: GrpcConfig | None = None
    """The gRPC binding (extra `grpc`); default: none."""


def check(config: A2aConfig) -> None:
    """Check the gRPC binding.

    :raises ConfigError: tokens would be sent without encryption.
    """
    found = config.grpc
    if found is None:
        return
    if (found.certificate is None) != (found.key is None):
        raise ConfigError("[plugins.a2a.grpc] needs both `certificate` and `key`, or neither")
    if found.certificate is None and not _is_loopback(found.host):
        raise ConfigError(
            f"[plugins.a2a.grpc]: '{found.host}' can be reached by others: set `certificate` and `key`"
        )


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"
