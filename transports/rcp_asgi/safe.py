"""Safety checks for an address that other machines can reach."""

from __future__ import annotations

from ipaddress import IPv6Address
from urllib.parse import urlsplit

from rcp_asgi.config import AsgiConfig
from rcp_asgi.origins import is_loopback
from rcp_asgi.proxies import Proxies
from rcp_asgi.tls import Tls
from rcp_gateway.api import GatewayConfig
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import ConfigError

__all__ = ["check_door", "check_open"]


def check_open(config: AsgiConfig, gateway: GatewayConfig) -> None:
    """Refuse a non-loopback address without TLS, or without effective authentication.

    :raises ConfigError: the configuration is unsafe, or a certificate or proxy is invalid.
    """
    _check_host(config.host)
    Proxies(config.proxies)
    if config.tls is not None:
        Tls(config.tls)
    # A feature or a stored token may authenticate clients, which is only known once features have
    # started: see `check_door`.
    elsewhere = bool(gateway.features or gateway.jwt) or gateway.store.path is not None
    _check(config, closed=gateway.closed, served=gateway.serves or elsewhere)


def check_door(config: AsgiConfig, client_api: ClientApi) -> None:
    """Repeat the checks of `check_open` once the features have started.

    :raises ConfigError: the configuration is unsafe.
    """
    _check(config, closed=client_api.requires_authentication, served=client_api.serves)


def _check_host(host: str) -> None:
    """Refuse what is a URL, or has a port, before it is taken for the name of another machine."""
    is_url = "://" in host
    if not is_url and _is_ipv6(host):
        return
    try:
        url = urlsplit(host if is_url else f"//{host}")
        name, port = url.hostname, url.port
    except ValueError:  # no port, or brackets that do not fit
        name, port = None, None
    if name == host.lower():
        return
    advice = f"write host = '{name}'" if name else "write the name or the address alone"
    raise ConfigError(
        f"[transports.asgi] host = '{host}' is no address: {advice}"
        + (f" and port = {port}" if port is not None else "")
    )


def _is_ipv6(host: str) -> bool:
    try:
        return bool(IPv6Address(host))
    except ValueError:
        return False


def _check(config: AsgiConfig, *, closed: bool, served: bool) -> None:
    if is_loopback(config.host):
        return
    where = f"[transports.asgi] host = '{config.host}' is reachable from other machines"
    if not closed:
        raise ConfigError(
            f"{where}, but clients need no credentials: set `anonymous = false`, or listen on "
            "127.0.0.1"
        )
    if not served:
        raise ConfigError(
            f"{where}, but no credentials give a role with any rights: "
            "add [[keys]] or [[certificates]], or listen on 127.0.0.1"
        )
    if config.tls is None and not config.plaintext:
        raise ConfigError(
            f"{where}, and keys would cross the network in plain text: add [transports.asgi.tls], "
            "or set `plaintext = true` if a proxy in front of it adds TLS"
        )
