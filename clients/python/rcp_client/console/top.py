"""`rcpctl top`: one screen of a gateway's robots, rates and warnings."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from rcp_client.client import Client
from rcp_client.console.extra import needs
from rcp_client.console.output import Output, clean
from rcp_client.console.show import (
    latched_line,
    logged,
    robot_charge,
    robot_controller,
    robot_state,
)
from rcp_protocol.errors import RcpError

if TYPE_CHECKING:
    from rich.console import RenderableType

__all__ = ["top"]

_PERIOD = 1.0  # s
_WARNINGS = 8
_COLORS = {"ready": "green", "ok": "green", "degraded": "yellow", "opening": "yellow"}


async def top(client: Client, out: Output, args: dict[str, Any]) -> int:
    """Show the screen until Ctrl-C; once without a terminal that can show one."""
    with needs("top"):
        from rich.console import Console
        from rich.live import Live
    screen = _Screen(client)
    console = Console()
    if not out.terminal or console.is_dumb_terminal or args["once"]:
        await screen.look()
        await asyncio.sleep(_PERIOD)
        await screen.look()
        if out.json and out.asked_json:
            out.document(screen.facts)
        else:
            console.print(screen.picture())
        return 0
    with Live(console=console, screen=True, auto_refresh=False) as live:
        while True:
            await screen.look()
            live.update(screen.picture(), refresh=True)
            await asyncio.sleep(_PERIOD)


class _Screen:
    """What was seen last, and the rates since the time before."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._samples: dict[str, tuple[float, int]] = {}
        self._rates: dict[str, float] = {}
        self._status: dict[str, Any] = {}
        self._robots: list[dict[str, Any]] = []
        self._estop: dict[str, Any] = {}
        self._running: list[dict[str, Any]] = []

    @property
    def facts(self) -> dict[str, Any]:
        """What the screen shows, for a program."""
        return {
            "status": self._status,
            "rates": self._rates,
            "robots": self._robots,
            "estop": self._estop,
            "running": self._running,
        }

    async def look(self) -> None:
        """Ask the gateway; a role may not be allowed to see everything."""
        self._status = await self._client.status()
        now = time.monotonic()
        for backend in self._status.get("backends") or []:
            name, samples = backend["name"], backend.get("samples") or 0
            before = self._samples.get(name)
            if before is not None and now > before[0]:
                self._rates[name] = max(0.0, (samples - before[1]) / (now - before[0]))
            self._samples[name] = (now, samples)
        with suppress(RcpError):
            self._robots = await self._client.robots()
        with suppress(RcpError):
            self._estop = await self._client.read("/system/estop")
        with suppress(RcpError):
            listed = await self._client.commands()
            self._running = [one for one in listed if "finished" not in one]

    def picture(self) -> RenderableType:
        """Draw it."""
        from rich.console import Group
        from rich.text import Text

        parts: list[RenderableType] = []
        if (latch := latched_line(self._estop)) is not None:
            parts.append(Text(clean(latch), style="bold white on red"))
        parts.append(self._head())
        parts.append(self._backends())
        if self._robots:
            parts.append(self._robot_table())
        if self._running:
            parts.append(self._commands())
        warnings = (self._status.get("warnings") or [])[-_WARNINGS:]
        parts += [
            Text(
                clean(f"{one.get('timestamp', '')[11:19]} {logged(one)}"),
                no_wrap=True,
                overflow="ellipsis",
            )
            for one in warnings
        ]
        return Group(*parts)

    def _head(self) -> RenderableType:
        from rich.text import Text

        status = self._status
        process, commands = status.get("process") or {}, status.get("commands") or {}
        queues = status.get("queues") or {}
        state = str(status.get("state"))
        return Text.assemble(
            (state, _COLORS.get(state, "red")),
            f"  version {status.get('version')}  up {status.get('uptime', 0):.0f} s  "
            f"cpu {process.get('cpu', 0):.0f} %  memory {(process.get('rss') or 0) / 1e6:.0f} MB  "
            f"sessions {status.get('sessions')}  subscriptions {status.get('subscriptions')}  "
            f"commands {commands.get('running')} running, {commands.get('queued')} queued  "
            f"dropped {queues.get('dropped', 0)}",
        )

    def _backends(self) -> RenderableType:
        rows = [
            (
                one["name"],
                one["plugin"],
                one["tenant"],
                one["state"],
                str(one.get("resources", "")),
                f"{self._rates.get(one['name'], 0):.0f}",
                "" if one.get("latency") is None else f"{one['latency'] * 1e3:.1f}",
                one.get("detail") or "",
            )
            for one in self._status.get("backends") or []
        ]
        head = ("BACKEND", "PLUGIN", "TENANT", "STATE", "RESOURCES", "SAMPLES/S", "MS", "DETAIL")
        return _table(head, rows)

    def _robot_table(self) -> RenderableType:
        rows = [
            (
                one["path"],
                one.get("kind") or "",
                robot_state(one),
                one.get("mode") or "",
                robot_charge(one),
                robot_controller(one),
            )
            for one in self._robots
        ]
        return _table(("ROBOT", "KIND", "STATE", "MODE", "BATTERY", "CONTROL"), rows)

    def _commands(self) -> RenderableType:
        rows = [
            (
                one["path"],
                one["status"],
                "" if one.get("progress") is None else f"{one['progress']:.0%}",
                one.get("principal") or "",
            )
            for one in self._running
        ]
        return _table(("COMMAND", "STATUS", "DONE", "BY"), rows)


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> RenderableType:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, header_style="dim", pad_edge=False)
    for name in head:
        table.add_column(name, overflow="ellipsis", no_wrap=True)
    for row in rows:
        cells = [Text(clean(cell), style=_COLORS.get(cell, "")) for cell in row]
        state = head.index("STATE") if "STATE" in head else None
        if state is not None and not cells[state].style:
            cells[state].style = "red"
        table.add_row(*cells)
    return table
