"""Draw `docs/demo.svg`: what a terminal shows of the demo, from a demo that really runs.

Run as `make picture`, and commit the result.
"""

from __future__ import annotations

import os
import pty
import re
import select
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console
from rich.terminal_theme import SVG_EXPORT_THEME
from rich.text import Text

DOCS = Path(__file__).parents[1] / "docs"
BIN = Path(sys.executable).parent
WIDTH = 100
COMMANDS = (
    "rcpctl discover '/action/*'",
    "rcpctl write /param/speed_limit 9",
    'rcpctl execute /action/move_to \'{"position": {"x": 4, "y": 0}}\' --no-wait',
    "rcpctl watch /sensor/pose --field position --rate 2 --count 4",
    "rcpctl estop --reason 'person in the hall'",
    "rcpctl execute /action/dock",
)


class Terminal:
    """A process on a terminal of its own."""

    def __init__(self, command: str, environment: dict[str, str]) -> None:
        self._master, slave = pty.openpty()
        self.process = subprocess.Popen(  # noqa: S603 - our own commands
            shlex.split(command), stdin=slave, stdout=slave, stderr=slave, env=environment
        )
        os.close(slave)
        self.text = ""

    def read(self, until: str | None, patience: float = 60.0) -> str:
        """Read until a word, or to the end."""
        end = time.monotonic() + patience
        while until is None or until not in self.text:
            if not select.select([self._master], [], [], max(0.0, end - time.monotonic()))[0]:
                raise TimeoutError(self.text)
            try:
                chunk = os.read(self._master, 65536)
            except OSError:  # the terminal's other end is closed: the process has ended
                break
            self.text += chunk.decode()
        return self.text.replace("\r\n", "\n")


def main() -> None:
    """Run the demo and the commands; write the picture."""
    console = Console(record=True, width=WIDTH, file=open(os.devnull, "w"), force_terminal=True)  # noqa: SIM115, PTH123
    with TemporaryDirectory() as runtime:
        environment = os.environ | {
            "PATH": f"{BIN}:{os.environ['PATH']}",
            "XDG_RUNTIME_DIR": runtime,
            "COLUMNS": str(WIDTH),
            "TERM": "xterm-256color",
        }
        demo = Terminal("rcpd demo --port 0", environment)
        try:
            banner = demo.read("Ready.")
            found = re.search(r"http://[\w.:]+", banner)
            assert found is not None, banner
            environment["RCP_URL"] = url = found[0]
            environment["RCP_TENANT"] = "alpha"
            _show(
                console,
                "make demo",
                banner.partition("\n\n")[0].replace(url, "http://127.0.0.1:8080"),
            )
            for command in COMMANDS:
                _show(console, command, Terminal(command, environment).read(None))
        finally:
            demo.process.send_signal(signal.SIGTERM)
            demo.process.wait(60)
    svg = console.export_svg(title="rcp-gateway", theme=SVG_EXPORT_THEME)
    # No font is fetched from anywhere: the reader's own monospaced one will do.
    svg = re.sub(r"@font-face \{.*?\}\s*", "", svg, flags=re.DOTALL)
    svg = svg.replace("Fira Code", "ui-monospace, monospace")
    svg = re.sub(
        r'x="([\d.]+)"( y="[\d.]+") textLength="([\d.]+)"([^>]*)>((?:&#160;)+)', _shift, svg
    )
    svg = re.sub(r"<!-- Generated.*?-->", "", svg)
    (DOCS / "demo.svg").write_text(svg, encoding="utf-8")


def _shift(text: re.Match[str]) -> str:
    """Move a text instead of beginning it with blanks, which some viewers drop."""
    width = 12.2 * text[5].count("&")
    x, length = float(text[1]) + width, max(0.0, float(text[3]) - width)
    return f'x="{x:g}"{text[2]} textLength="{length:g}"{text[4]}>'


def _show(console: Console, command: str, output: str) -> None:
    console.print(Text.assemble(("$ ", "bold green"), (command, "bold")))
    console.print(Text.from_ansi(output.rstrip()), soft_wrap=False)
    console.print()


if __name__ == "__main__":
    main()
