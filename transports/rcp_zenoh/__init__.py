"""The session API over Zenoh: a gateway that dials out to the routers of its fleet."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_kernel.api import GatewayConfig
from rcp_kernel.client_kinds import TransportKind
from rcp_kernel.errors import ConfigError
from rcp_kernel.hookspecs import hookimpl
from rcp_zenoh.config import ZenohConfig
from rcp_zenoh.tls import check_links, check_name
from rcp_zenoh.transport import open_zenoh

__all__ = ["ZenohConfig", "open_zenoh", "rcp_transports"]


def _check(config: ZenohConfig, _gateway: GatewayConfig) -> None:
    try:
        check_links(config.connect, config.tls)
        check_name(config.gateway, config.tls)
    except ConfigError as error:
        raise ConfigError(f"[transports.zenoh]: {error}") from None


@hookimpl
def rcp_transports() -> Iterable[TransportKind]:
    """Provide Zenoh."""
    return [TransportKind("zenoh", ZenohConfig, open_zenoh, __doc__ or "", check=_check)]
