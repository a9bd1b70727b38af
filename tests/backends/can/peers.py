"""Devices that are not ours: durand's CANopen responder, and canopen's LocalNode."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
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
        turning.join(2)
        network.stop()
        line.shutdown()


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


def drive_eds(file: Path, *, node: int, left_out: Sequence[int] = ()) -> Path:
    """Write the EDS of a drive whose PDOs are mapped as CiA 402-3 has them from the factory."""
    import canopen
    from canopen import objectdictionary as od

    from rcp_can.sim.cia402_objects import make_dictionary

    receive = ((0x6040,), (0x6040, 0x6060), (0x6040, 0x607A), (0x6040, 0x60FF))
    transmit = ((0x6041,), (0x6041, 0x6061), (0x6041, 0x6064), (0x6041, 0x606C))
    bits = {0x6060: 8, 0x6061: 8, 0x6040: 16, 0x6041: 16}
    made = make_dictionary(node)

    def entry(name: str, index: int, sub: int, kind: int, value: int) -> od.ODVariable:
        found = od.ODVariable(name, index, sub)
        found.data_type, found.default = kind, value
        return found

    for base, id_, pdos in ((0x1400, 0x200, receive), (0x1800, 0x180, transmit)):
        for number, objects in enumerate(pdos):
            index = base + number
            record, mapping = od.ODRecord("PDO", index), od.ODArray("Mapping", index + 0x200)
            off = 0x80000000 if index in left_out else 0
            cob = entry("COB-ID", index, 1, od.UNSIGNED32, 0)
            cob.default_raw = f"$NODEID+0x{id_ + 0x100 * number + off:X}"
            record.add_member(entry("Entries", index, 0, od.UNSIGNED8, 5))
            record.add_member(cob)
            record.add_member(entry("Type", index, 2, od.UNSIGNED8, 255))
            record.add_member(entry("Event timer", index, 5, od.UNSIGNED16, 20))
            mapping.add_member(entry("Entries", index + 0x200, 0, od.UNSIGNED8, len(objects)))
            for sub, each in enumerate(objects, 1):
                word = each << 16 | bits.get(each, 32)
                mapping.add_member(entry("Object", index + 0x200, sub, od.UNSIGNED32, word))
            made.add_object(record)
            made.add_object(mapping)
    with file.open("w") as out:
        canopen.export_od(made, out, "eds")
    return file
