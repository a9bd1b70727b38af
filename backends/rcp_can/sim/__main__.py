"""Run simulated drives on a bus in a separate process: `python -m rcp_can.sim odrive:1 …`."""

from __future__ import annotations

import argparse
import sys
import threading
from collections.abc import Sequence

import can

from rcp_can.profiles import PROFILES, profile
from rcp_can.sim import Bench, Twin, make_twin
from rcp_kernel.errors import ConfigError

__all__ = ["main"]


def _twin(text: str) -> Twin:
    name, _, node = text.rpartition(":")
    try:
        nodes = profile(name).nodes
    except ConfigError as error:
        known = ", ".join(PROFILES)
        raise argparse.ArgumentTypeError(f"{error}; known profiles: {known}") from error
    if not node.isdecimal() or int(node) not in nodes:
        raise argparse.ArgumentTypeError(f"{text!r} is not <profile>:<node>")
    return make_twin(name, int(node))


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line and run until interrupted, or for `--seconds`."""
    parser = argparse.ArgumentParser(prog="python -m rcp_can.sim", description=__doc__)
    parser.add_argument("drives", nargs="+", type=_twin, metavar="PROFILE:NODE")
    parser.add_argument("--interface", default="udp_multicast", help="a python-can interface")
    parser.add_argument("--channel", default="239.74.163.2")
    parser.add_argument("--fd", action="store_true", help="use CAN FD, as moteus requires")
    parser.add_argument(
        "--seconds", type=float, help="how long to run, in s; without it, until stopped"
    )
    options = parser.parse_args(arguments)
    more = {} if options.interface == "virtual" else {"fd": options.fd}
    bus = can.Bus(options.channel, options.interface, ignore_config=True, **more)
    with Bench(bus, options.drives):
        sys.stdout.write(f"{len(options.drives)} drives on {bus.channel_info}\n")
        sys.stdout.flush()
        try:
            threading.Event().wait(options.seconds)
        except KeyboardInterrupt:
            return


if __name__ == "__main__":
    main()
