"""The faults of one motor, published when they appear and when they clear."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_can import motor_messages as m
from rcp_can.drive import Fault
from rcp_kernel.spi import Host

__all__ = ["FaultBook"]

_STAYING = frozenset(("feedback_lost", "heartbeat_lost", "configuration"))
"""Faults that clear when their cause ends, not by acknowledgement."""


class FaultBook:
    """The active faults; published as `event/<motor>/fault`."""

    def __init__(self, motor: str, host: Host) -> None:
        self.active: dict[str, Fault] = {}
        self._own: dict[str, Fault] = {}
        self._event, self._host = f"event/{motor}/fault", host

    def note(self, fault: Fault) -> None:
        """Activate a fault detected by the gateway until it is cleared."""
        self._own[fault.name] = fault

    def get(self, name: str) -> Fault | None:
        """Return a fault detected by the gateway, if it is active."""
        return self._own.get(name)

    def clear(self, *names: str) -> None:
        """Clear the named faults detected by the gateway."""
        for name in names:
            self._own.pop(name, None)

    def acknowledge(self) -> None:
        """Clear faults detected by the gateway, except those whose cause persists."""
        self._own = {name: fault for name, fault in self._own.items() if name in _STAYING}

    def update(self, of_the_drive: Iterable[Fault]) -> None:
        """Publish the faults that have appeared or cleared since the last call."""
        faults = {fault.name: fault for fault in of_the_drive} | self._own
        before = self.active
        if faults == before:
            return
        self.active = faults
        for name, fault in faults.items():
            if before.get(name) != fault:
                self.publish(fault, active=True)
        for name in before.keys() - faults.keys():
            self.publish(before[name], active=False)

    def publish(self, fault: Fault, *, active: bool) -> None:
        """Publish that a fault has appeared or cleared."""
        value = m.MotorFault(fault=fault.name, text=fault.text, active=active, code=fault.code)
        self._host.publish(self._event, value)
