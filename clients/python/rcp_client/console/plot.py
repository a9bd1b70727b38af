"""`rcpctl plot`: numbers over time, drawn in the terminal."""

from __future__ import annotations

import asyncio
import shutil
import time
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import click

from rcp_client.client import Client
from rcp_client.console.extra import needs
from rcp_client.console.output import Output
from rcp_client.console.show import number_or_text
from rcp_client.messages import Update

__all__ = ["plot"]

_COLORS = ("green", "yellow", "cyan", "magenta", "red", "blue", "white")
_PERIOD = 0.25  # s between two pictures
_POINTS = 2000  # of one line
_MOST = len(_COLORS)
_HOME = "\x1b[H"


async def plot(client: Client, out: Output, args: dict[str, Any]) -> int:
    """Draw what is received until the time is over or Ctrl-C; without a terminal, draw once at the end."""
    with needs("plot"):
        import plotille  # noqa: F401 - a fault of the command line, before anything is sent
    picture = _Picture(out, args["span"])
    subscription = client.subscribe(
        args["patterns"],
        rate=args["rate"],
        fields=args["fields"],
        frame=args["frame"],
        duration=args["duration"],
        count=args["count"],
        history=number_or_text(args["history"]),
    )
    drawing = asyncio.create_task(_draw(picture)) if out.terminal else None
    try:
        async with subscription:
            async for update in subscription:
                if isinstance(update, Update):
                    picture.add(update)
    finally:
        if drawing is not None:
            drawing.cancel()
            with suppress(asyncio.CancelledError):
                await drawing
    if not picture.lines:
        raise click.UsageError("no number was received; choose one with --field, as position.x")
    if out.json and out.asked_json:
        for name, points in picture.lines.items():
            out.document({"name": name, "points": [list(point) for point in points]})
    else:
        out.line(picture.text(clear=False))
    return 0


async def _draw(picture: _Picture) -> None:
    while True:
        await asyncio.sleep(_PERIOD)
        if picture.lines:
            picture.show()


class _Picture:
    """The lines so far: seconds since the first sample, and values."""

    def __init__(self, out: Output, span: float) -> None:
        self._out, self._span = out, span
        self._began: float | None = None
        self.lines: dict[str, deque[tuple[float, float]]] = {}

    def add(self, update: Update) -> None:
        """Add the numbers of an update."""
        moment = _seconds(update.timestamp)
        if self._began is None:
            self._began = moment
        for field, number in _numbers(update.body, ""):
            name = f"{update.path}{field}"
            if name not in self.lines and len(self.lines) == _MOST:
                continue
            line = self.lines.setdefault(name, deque(maxlen=_POINTS))
            line.append((moment - self._began, number))

    def show(self) -> None:
        """Draw over the last picture."""
        self._out.line(_HOME + self.text(clear=True))

    def text(self, *, clear: bool) -> str:
        """Return the picture of the last seconds, with a legend of current values."""
        import plotille

        columns, rows = shutil.get_terminal_size((80, 24))
        figure: Any = plotille.Figure()
        figure.width = max(20, columns - 14)
        figure.height = max(5, rows - len(self.lines) - 5)
        figure.color_mode = "names"
        figure.with_colors = self._out.colors
        figure.x_label, figure.y_label = "s", "value"
        end = max(line[-1][0] for line in self.lines.values())
        legend: list[str] = []
        for color, (name, line) in zip(_COLORS, self.lines.items(), strict=False):
            points = [point for point in line if point[0] >= end - self._span]
            times, values = zip(*points, strict=True) if points else ((end,), (line[-1][1],))
            figure.plot(times, values, lc=color)
            mark = plotille.color("━━", fg=color, no_color=not self._out.colors)
            legend.append(f"{mark} {name} = {line[-1][1]:.6g}")
        text = "\n".join([figure.show(), *legend])
        return "\n".join(f"{line}\x1b[K" for line in text.split("\n")) + "\x1b[J" if clear else text


def _numbers(value: Any, at: str) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a value with their fields."""
    if isinstance(value, bool):
        yield at, float(value)
    elif isinstance(value, (int, float)):
        if value == value and abs(value) != float("inf"):  # noqa: PLR0124 - not a number
            yield at, float(value)
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from _numbers(item, f"{at}.{key}")
    elif isinstance(value, list) and len(value) <= _MOST:
        for index, item in enumerate(value):
            yield from _numbers(item, f"{at}[{index}]")


def _seconds(timestamp: str) -> float:
    whole, _, fraction = timestamp.removesuffix("Z").partition(".")
    moment = time.strptime(whole, "%Y-%m-%dT%H:%M:%S")
    return time.mktime(moment) + float(f"0.{fraction or 0}")
