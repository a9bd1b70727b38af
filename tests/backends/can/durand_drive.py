"""A CiA 402 drive on durand: its SDO server, PDOs, heartbeat and EMCY, a state machine written here."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from backends.can.peers import durand_network
from rcp_can.sim import Plant

COUNTS = 4096 / (2 * math.pi)
STATES = {"off": 0x250, "ready": 0x231, "on": 0x233, "run": 0x237, "quick": 0x217, "fault": 0x218}
VARIABLES = {
    **dict.fromkeys((0x6081, 0x6083, 0x6084), "UNSIGNED32"),
    **dict.fromkeys((0x6064, 0x606C, 0x607A, 0x60FF), "INTEGER32"),
    **dict.fromkeys((0x6040, 0x6041), "UNSIGNED16"),
    **dict.fromkeys((0x605A, 0x6071, 0x6077), "INTEGER16"),
    **dict.fromkeys((0x6060, 0x6061, 0x6098), "INTEGER8"),
}


class DurandDrive:
    """The state machine of CiA 402-2, in a thread; profile position, profile and cyclic velocity."""

    def __init__(self, network: Any, node: int) -> None:
        import durand

        od = durand.object_dictionary.ObjectDictionary()
        for index, kind in VARIABLES.items():
            od[index] = durand.Variable(getattr(durand.DatatypeEnum, kind), "rw", 0)
        self.od, self.plant, self.state = od, Plant(), "off"
        self.node = durand.MinimalNode(network, node, od)
        self.control = 0
        self.taken = False
        self._lock = threading.RLock()
        self._end = threading.Event()
        self._words: deque[int] = deque()  # the targets of a PDO come behind its control word
        od.update_callbacks[0x6040, 0].add(self._words.append)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def get(self, index: int) -> int:
        return self.od.read(index, 0)

    def obey(self, word: int) -> None:
        with self._lock:
            old, self.control = self.control, word
            if self.state == "fault":
                if word & 0x80 and not old & 0x80:
                    self.state = "off"
                    self.node.emcy.set(0, 0)
                return
            if not word & 2:
                self.state = "off"
            elif not word & 4:
                self.state = "quick" if self.state in ("run", "quick") else "off"
            elif word & 0xF == 6:
                self.state = "ready"
            elif word & 0xF == 7 and self.state != "off":
                self.state = "on"
            elif word & 0xF == 0xF and self.state in ("on", "run"):
                self.state = "run"
            new = bool(word & 0x10)
            if self.state == "run" and self.get(0x6060) == 1 and new and not old & 0x10:
                self.plant.loop, self.plant.goal = "position", self.get(0x607A) / COUNTS
                self.plant.speed = max(self.get(0x6081), 1) / COUNTS
            self.taken = new

    def fail(self, code: int) -> None:
        with self._lock:
            self.state = "fault"
            self.node.emcy.set(code, 1)

    def _run(self) -> None:
        while not self._end.wait(0.004):
            with self._lock:
                while self._words:
                    self.obey(self._words.popleft())
                self._follow()
                self.plant.advance(0.004)
                self._tell()

    def _follow(self) -> None:
        plant, mode = self.plant, self.get(0x6060)
        if self.state == "quick" or (self.state == "run" and mode not in (1, 3, 9)):
            plant.hold()
        elif self.state != "run":
            plant.off()
        elif mode in (3, 9):
            plant.loop, plant.goal = "velocity", self.get(0x60FF) / COUNTS

    def _tell(self) -> None:
        plant, word = self.plant, STATES[self.state]
        if self.state == "run" and self.get(0x6060) == 1:
            near = plant.loop == "position" and abs(plant.goal - plant.position) < 0.005
            word |= (near and abs(plant.velocity) < 0.05) << 10 | self.taken << 12
        self.od.write(0x6041, 0, word)
        self.od.write(0x6061, 0, self.get(0x6060))
        self.od.write(0x6064, 0, round(plant.position * COUNTS))
        self.od.write(0x606C, 0, round(plant.velocity * COUNTS))
        self.od.write(0x6077, 0, round(plant.torque * 1000))

    def close(self) -> None:
        self.od.write(0x1017, 0, 0)  # or its scheduler would never end
        self._end.set()
        self._thread.join(5)


@contextmanager
def durand_drive(channel: str, node: int) -> Iterator[DurandDrive]:
    with durand_network(channel) as network:
        drive = DurandDrive(network, node)
        try:
            yield drive
        finally:
            drive.close()
