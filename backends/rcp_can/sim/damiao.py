"""A simulated Damiao: registers in memory, which it forgets unless they are stored."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

from rcp_can.codec import Span
from rcp_can.profiles.damiao_registers import (
    ESC_ID,
    MODE,
    MST_ID,
    RANGES,
    REGISTERS,
    SUB_VERSION,
    TIMEOUT,
    VERSION,
)
from rcp_can.profiles.mit import Ranges, command_codec, reply_codec
from rcp_can.sim.mit import MitTwin
from rcp_can.sim.plant import Plant

if TYPE_CHECKING:
    import can

__all__ = ["DamiaoTwin"]

_REGISTERS = 0x7FF
_READ, _WRITE, _STORE, _REFRESH = 0x33, 0x55, 0xAA, 0xCC
_FACTORY = {
    0: 15.0,
    1: 0.0,
    2: 100.0,
    3: 0.95,
    4: 10.0,
    5: -10.0,
    6: 50.0,
    20: 10.0,
    24: 1000.0,
    25: 0.004,
    26: 0.002,
    27: 50.0,
    28: 0.0,
    29: 32.0,
    30: 1.0,
    31: 4.0,
    32: 50.0,
    33: 1000.0,
    34: 100.0,
}
_WRITABLE = {ESC_ID, MST_ID, TIMEOUT, MODE, 35}


class DamiaoTwin(MitTwin):
    """A Damiao, with its registers and watchdog."""

    model = "4310"
    extra = (Span("drive", 8), Span("motor", 8))

    def __init__(self, node: int, plant: Plant | None = None, **options: Any) -> None:
        super().__init__(node, plant, **options)
        self.registers = {
            number: struct.pack(
                "<" + each.code, _FACTORY.get(number, 0.0 if each.code == "f" else 0)
            )
            for number, each in REGISTERS.items()
        }
        self.registers[MST_ID] = struct.pack("<I", options.get("reply_id", 0))
        self.registers[ESC_ID] = struct.pack("<I", node)
        self.registers[MODE] = struct.pack("<I", 1)
        self.registers[VERSION] = struct.pack("<I", 5013)
        self.registers[SUB_VERSION] = struct.pack("<I", 2)
        for number, scale in zip(RANGES, self.span, strict=True):
            self.registers[number] = struct.pack("<f", scale)
        self.stored = dict(self.registers)
        self.stores = 0
        """How often it has stored its registers."""
        self.keeps: set[int] = set()
        """Registers that it acknowledges but does not change."""

    def boot(self) -> None:
        """Reboot with what is stored."""
        super().boot()
        self.registers = dict(self.stored)
        self._apply()

    def _apply(self) -> None:
        self.node = int.from_bytes(self.registers[ESC_ID], "little")
        scales = [struct.unpack("<f", self.registers[number])[0] for number in RANGES]
        self.span = Ranges(*scales)
        self._command = command_codec(self.span)
        self._reply = reply_codec(self.span, *self.extra)

    @property
    def reply_id(self) -> int:
        """The identifier of its responses."""
        return int.from_bytes(self.registers[MST_ID], "little")

    def _clear_by_disabling(self) -> None:
        """Keep the fault: it has a command of its own."""

    def break_down(self) -> None:
        """Trip on over-current."""
        super().break_down()
        self.fault = 0xA

    def more(self) -> dict[str, float]:
        """Add state and temperatures."""
        state = self.fault or int(self.enabled)
        return {"id": state << 4 | self.node & 0xF, "drive": 30, "motor": self.plant.temperature}

    def take(self, message: can.Message) -> None:
        """Handle register accesses as well."""
        data = bytes(message.data)
        if message.arbitration_id != _REGISTERS or len(data) < 4:
            super().take(message)
            return
        node, command, register = struct.unpack_from("<HBB", data)
        if node != self.node:
            return
        if command == _REFRESH:
            self.answer()
        elif command == _STORE:
            self._store(data)
        elif register in self.registers:  # it is silent about others
            if command == _WRITE and len(data) == 8:
                self._write(register, data[4:])
            elif command != _READ:
                return
            reply = struct.pack("<HBB", node, command, register) + self.registers[register]
            self.send(self.reply_id, reply)

    def _write(self, register: int, data: bytes) -> None:
        known = REGISTERS[register]
        if register in self.keeps or (known.low is None and register not in _WRITABLE):
            return
        if known.low is not None:
            value = struct.unpack("<f", data)[0]
            if not known.low <= value <= known.high:
                return
        self.registers[register] = data
        self._apply()

    def _store(self, data: bytes) -> None:
        if self.enabled:  # it stores only while it is disabled
            return
        self.stored = dict(self.registers)
        self.stores += 1
        self.send(self.reply_id, data[:4] + bytes(4))

    def tick(self, now: float) -> None:
        """Check the watchdog."""
        timeout = int.from_bytes(self.registers[TIMEOUT], "little") * 50e-6
        if self.enabled and timeout and self.is_quiet(timeout):
            self.enabled, self.fault = False, 0xD
            self.plant.off()
