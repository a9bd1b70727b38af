"""The listener's life: refuse what is not safe, bind, serve, and go within a bound."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress
from functools import partial
from typing import Any

import structlog
from uvicorn import Config, Server

from rcp_asgi.config import AsgiConfig
from rcp_asgi.front import FrontDoor
from rcp_asgi.house import OWN, house
from rcp_asgi.http import HttpProtocol
from rcp_asgi.origins import Origins, is_loopback
from rcp_asgi.settings import Settings
from rcp_asgi.upgrade import Upgrade
from rcp_kernel.config import GatewayConfig
from rcp_kernel.door import Door
from rcp_kernel.errors import ConfigError

__all__ = ["check_open", "open_asgi"]

log = structlog.get_logger("rcp.asgi")
_TICK = 1.0  # s between new Date headers
_BACKLOG = 1024


@asynccontextmanager
async def open_asgi(config: AsgiConfig, door: Door) -> AsyncGenerator[dict[str, Any]]:
    """Listen while entered.

    :raises ConfigError: the address is open to others and the gateway is not closed to strangers,
        or it cannot be listened on.
    """
    _check(config, door)
    listening = _bind(config)
    host, port = listening.getsockname()[:2]
    settings = Settings(config, door)
    origins = Origins(config.host, config.origins, config.hosts)
    front = FrontDoor(door, origins, house(door), OWN, config.root_path)
    server = _server(settings, front)
    await server.startup(sockets=[listening])
    await server.on_tick(0)
    ticking = asyncio.create_task(_tick(server), name="asgi clock")
    shown = f"[{host}]" if ":" in host else host
    url = f"http://{shown}:{port}"
    log.info("listening", url=url)
    try:
        yield {"url": url + config.root_path, "host": host, "port": port}
    finally:
        ticking.cancel()
        await _close(server, listening, settings)


def check_open(config: AsgiConfig, gateway: GatewayConfig) -> None:
    """Refuse an address open to others where strangers may do anything.

    :raises ConfigError: that is so.
    """
    if not is_loopback(config.host) and not gateway.closed:
        raise _open_to_strangers(config)


def _open_to_strangers(config: AsgiConfig) -> ConfigError:
    return ConfigError(
        f"[transports.asgi] host = '{config.host}' is open to others, and so is the gateway: "
        "write `anonymous = false`, or listen on 127.0.0.1"
    )


def _check(config: AsgiConfig, door: Door) -> None:
    if is_loopback(config.host):
        return
    if not door.secure:
        raise _open_to_strangers(config)
    if not door.has_keys:
        raise ConfigError(
            f"[transports.asgi] host = '{config.host}' is open to others, and nobody can prove who "
            "they are: add [[keys]], or listen on 127.0.0.1"
        )


def _bind(config: AsgiConfig) -> socket.socket:
    try:
        found = socket.getaddrinfo(
            config.host, config.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
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
            f"[transports.asgi] cannot listen on {config.host}:{config.port}: {why}"
        ) from None
    made.setblocking(False)
    return made


def _server(settings: Settings, front: FrontDoor) -> Server:
    uvicorn_config = Config(
        front,
        http=partial(HttpProtocol, settings=settings),  # type: ignore[arg-type] - a factory
        ws=Upgrade,
        lifespan="off",
        interface="asgi3",
        log_config=None,
        access_log=False,
        proxy_headers=False,
        server_header=False,
        backlog=_BACKLOG,
        timeout_keep_alive=settings.config.keep_alive,
    )
    uvicorn_config.load()
    server = Server(uvicorn_config)
    server.lifespan = uvicorn_config.lifespan_class(uvicorn_config)
    return server


async def _tick(server: Server) -> None:
    while True:
        await asyncio.sleep(_TICK)
        await server.on_tick(0)


async def _close(server: Server, listening: socket.socket, settings: Settings) -> None:
    for accepting in server.servers:
        accepting.close()
    listening.close()
    for finish in list(settings.closing):
        finish()
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
        async with asyncio.timeout(settings.config.grace):
            while state.connections:  # noqa: ASYNC110 - uvicorn tells nobody when one goes
                await asyncio.sleep(0.01)
    for connection in list(state.connections):
        transport: Any = getattr(connection, "transport", None)
        if transport is not None:
            transport.abort()
    await asyncio.sleep(0)
