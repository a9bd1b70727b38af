"""The listener's lifecycle: check the configuration, bind, serve, and stop within a time limit."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress
from functools import partial
from typing import Any

import structlog
from uvicorn import Config, Server

from rcp_asgi.acceptor import Acceptor
from rcp_asgi.builtin_app import OWN, builtin_app
from rcp_asgi.config import AsgiConfig
from rcp_asgi.connection_limiter import ConnectionLimiter, Seat
from rcp_asgi.http import HttpProtocol
from rcp_asgi.mount_router import MountRouter
from rcp_asgi.origins import Origins
from rcp_asgi.proxies import Proxies
from rcp_asgi.safe import check_door
from rcp_asgi.settings import Settings
from rcp_asgi.tls import Tls
from rcp_asgi.upgrade import Upgrade
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import ConfigError, UnknownPath
from rcp_protocol.timeouts import timeout
from rcp_web.asgi import Receive, Scope, Send, refuse

__all__ = ["open_asgi"]

log = structlog.get_logger("rcp.asgi")
_TICK = 1.0  # s between new Date headers, and between checks of the certificate files
_BACKLOG = 1024
_NO_PATHS: frozenset[str] = frozenset()
_HEADERS = [  # against pages of other origins that embed what they may not read
    ("x-content-type-options", "nosniff"),
    ("cross-origin-resource-policy", "same-origin"),
    ("content-security-policy", "frame-ancestors 'self'"),
]


@asynccontextmanager
async def open_asgi(config: AsgiConfig, client_api: ClientApi) -> AsyncGenerator[dict[str, Any]]:
    """Listen while entered.

    :raises ConfigError: the configuration is unsafe, or the address is not available.
    """
    check_door(config, client_api)
    tls = None if config.tls is None else Tls(config.tls)
    settings = Settings(config, client_api, Proxies(config.proxies))
    seats = ConnectionLimiter(config, settings.proxies)
    origins = Origins(config.host, config.origins, config.hosts)
    front = MountRouter(client_api, origins, builtin_app(client_api), OWN, config.root_path)
    main = _Port(_bind(config, config.port), front, settings, seats, tls)
    extra: dict[str, _Port] = {}
    try:
        for mount in client_api.mounts:
            if mount.port is not None and mount.name not in extra:
                router = MountRouter(client_api, origins, _nothing, _NO_PATHS, "", mount.port)
                bound = _bind(config, mount.port, f" (for [plugins.{mount.name}])")
                extra[mount.name] = _Port(bound, router, settings, seats, tls)
    except ConfigError:
        for port in (main, *extra.values()):
            port.acceptor.close()
        raise
    ports = [main, *extra.values()]
    for port in ports:
        await port.server.on_tick(0)
    if tls is not None:
        tls.warn()
        client_api.revoke(tls.revoked)
    ticking = asyncio.create_task(_tick(ports, seats, tls, client_api), name="asgi clock")
    for port in ports:
        port.acceptor.open()
        log.info("listening", url=port.url)
    facts: dict[str, Any] = {
        "url": main.url + config.root_path,
        "host": main.host,
        "port": main.number,
    }
    if tls is not None:
        facts["certificate"] = tls.facts
    if extra:
        facts["ports"] = {name: port.number for name, port in extra.items()}
    try:
        yield facts
    finally:
        ticking.cancel()
        for port in ports:
            port.acceptor.close()
        for finish in list(settings.closing):
            finish()
        await asyncio.gather(*(_close(port.server, settings) for port in ports))


class _Port:
    """One address that the listener listens on."""

    def __init__(
        self,
        listening: socket.socket,
        front: MountRouter,
        settings: Settings,
        seats: ConnectionLimiter,
        tls: Tls | None,
    ) -> None:
        self.host, self.number = listening.getsockname()[:2]
        self.server = _server(settings, front)
        make = partial(_protocol, self.server, settings)
        self.acceptor = Acceptor(listening, settings, tls, seats, make)
        shown = f"[{self.host}]" if ":" in self.host else self.host
        self.url = f"{'http' if tls is None else 'https'}://{shown}:{self.number}"


async def _nothing(scope: Scope, _receive: Receive, send: Send) -> None:
    """Answer what a port of a mount's own does not serve."""
    await refuse(send, UnknownPath(f"nothing found at {scope['path']}"))


def _bind(config: AsgiConfig, port: int, what: str = "") -> socket.socket:
    try:
        found = socket.getaddrinfo(
            config.host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )
        family, kind, protocol, _, address = found[0]
        made = socket.socket(family, kind, protocol)
        try:
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            made.bind(address)
            made.listen(_BACKLOG)
        except OSError:
            made.close()
            raise
    except OSError as error:
        why = error.strerror or str(error)
        raise ConfigError(
            f"[transports.asgi] cannot listen on {config.host}:{port}{what}: {why}"
        ) from None
    made.setblocking(False)
    return made


def _server(settings: Settings, front: MountRouter) -> Server:
    """Build the state that connections share; this server itself does not listen."""
    uvicorn_config = Config(
        front,
        ws=Upgrade,
        lifespan="off",
        interface="asgi3",
        log_config=None,
        access_log=False,
        proxy_headers=False,
        server_header=False,
        headers=_HEADERS,
        timeout_keep_alive=settings.config.keep_alive,
    )
    uvicorn_config.load()
    return Server(uvicorn_config)


def _protocol(server: Server, settings: Settings, seat: Seat) -> HttpProtocol:
    return HttpProtocol(
        settings=settings,
        seat=seat,
        config=server.config,
        server_state=server.server_state,
        app_state={},
        _loop=settings.client_api.loop,
    )


async def _tick(
    ports: list[_Port], seats: ConnectionLimiter, tls: Tls | None, client_api: ClientApi
) -> None:
    while True:
        await asyncio.sleep(_TICK)
        for port in ports:
            await port.server.on_tick(0)
        seats.sweep(client_api.loop.time())
        if tls is not None and tls.refresh():
            client_api.revoke(tls.revoked)


async def _close(server: Server, settings: Settings) -> None:
    state = server.server_state
    for connection in list(state.connections):
        connection.shutdown()
    tasks = set(state.tasks)
    if tasks:
        _, late = await asyncio.wait(tasks, timeout=settings.config.grace)
        for task in late:
            task.cancel()
        if late:
            await asyncio.wait(late, timeout=settings.config.grace)
    with suppress(TimeoutError):
        async with timeout(settings.config.grace):
            while state.connections:  # noqa: ASYNC110 - uvicorn does not signal when a connection ends
                await asyncio.sleep(0.01)
    for connection in list(state.connections):
        transport: Any = getattr(connection, "transport", None)
        if transport is not None:
            transport.abort()
    await asyncio.sleep(0)
