"""Devices that are not ours: durand's CANopen responder, and canopen's LocalNode."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import can


@contextmanager
def durand_network(channel: str) -> Iterator[Any]:
    """Run durand's scheduler and network on a virtual bus."""
    import durand
    from durand.scheduler import SyncScheduler, get_scheduler

    scheduler = SyncScheduler()
    durand.set_scheduler(scheduler)
    turning = threading.Thread(target=scheduler.run, daemon=True)
    line = can.Bus(channel, "virtual", ignore_config=True)
    network = durand.CANBusNetwork(line)
    turning.start()
    try:
        yield network
    finally:
        with contextlib.suppress(Exception):
            get_scheduler().stop()
        network.stop()
        line.shutdown()
        turning.join(2)


@contextmanager
def local_node(channel: str, node: int, dictionary: Any) -> Iterator[Any]:
    """Run canopen's LocalNode on a virtual bus."""
    import canopen

    network = canopen.Network()
    network.connect(channel=channel, interface="virtual", ignore_config=True)
    try:
        yield network.create_node(node, dictionary)
    finally:
        network.disconnect()
