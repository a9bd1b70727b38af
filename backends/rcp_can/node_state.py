"""The state of a CANopen node, from heartbeats and emergencies (CiA 301, 7.2.8.3 and 7.2.7)."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Annotated, Literal

from msgspec import Meta, Struct

from rcp_can.bus import Bus, Route
from rcp_can.config_node import NodeConfig
from rcp_can.health import Health
from rcp_can.profiles.cia402_objects import emergency
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host

if TYPE_CHECKING:
    import can

__all__ = ["Emergency", "NodeState", "NodeWatch"]

Code = Annotated[int, Meta(ge=0, le=0xFFFF, extra_json_schema={"unit": "1"})]
State = Literal["unknown", "booting", "stopped", "operational", "pre_operational", "offline"]
_STATES: dict[int, State] = {
    0x00: "booting",
    0x04: "stopped",
    0x05: "operational",
    0x7F: "pre_operational",
}
_HEARTBEAT, _EMERGENCY = 0x700, 0x080


class NodeState(Struct, frozen=True, kw_only=True):
    """The NMT state and the active emergencies."""

    state: State
    emergencies: list[str] = []
    """The active emergencies as text."""


class Emergency(Struct, frozen=True, kw_only=True):
    """An emergency that was raised, or all of them cleared."""

    code: Code
    text: str
    active: bool


class NodeWatch:
    """Monitors one node, and its heartbeats if a period is configured."""

    def __init__(self, name: str, config: NodeConfig, bus: Bus, host: Host, health: Health) -> None:
        self._name, self._host, self._health = name, host, health
        self._node, self._within = config.node, config.heartbeat
        self._state: State = "unknown"
        self._emergencies: dict[int, str] = {}
        self._missing: asyncio.TimerHandle | None = None
        bus.listen(self._on_heartbeat, Route(_HEARTBEAT + config.node), whose=name)
        bus.listen(self._on_emergency, Route(_EMERGENCY + config.node), whose=name)

    @property
    def value(self) -> NodeState:
        """The current state."""
        return NodeState(state=self._state, emergencies=list(self._emergencies.values()))

    @property
    def path(self) -> str:
        """The name of its state resource."""
        return f"sensor/{self._name}/state"

    def resources(self) -> list[Resource]:
        """List its state and its emergencies."""
        return [
            Resource(
                name=self.path,
                description=f"NMT state of CANopen node {self._node}, from its heartbeats.",
                value=NodeState,
                live=True,
                deadline=self._within,
            ),
            Resource(
                name=f"event/{self._name}/emergency",
                description=f"An emergency of CANopen node {self._node} was raised, or all were cleared.",
                value=Emergency,
                live=True,
            ),
        ]

    def start(self) -> None:
        """Start to monitor heartbeats."""
        if self._within is not None:
            self._expect(self._within)

    def stop(self) -> None:
        """Stop to monitor heartbeats."""
        if self._missing is not None:
            self._missing.cancel()

    def _expect(self, within: float) -> None:
        self.stop()
        self._missing = asyncio.get_running_loop().call_later(within, self._lose, within)

    def _lose(self, within: float) -> None:
        self._state = "offline"
        text = f"CANopen node {self._node} ('{self._name}') has sent no heartbeat for {within:g} s"
        self._health.report(self._name, text)
        self._host.publish(self.path, self.value)

    def _on_heartbeat(self, message: can.Message) -> None:
        if len(message.data) < 1 or (state := _STATES.get(message.data[0] & 0x7F)) is None:
            raise ValueError("not a heartbeat")
        if self._within is not None:
            self._expect(self._within)
            self._health.report(self._name, None)
        if state == "booting":
            self._emergencies.clear()
        if state != self._state or self._within is not None:  # an unpublished one would go stale
            self._state = state
            self._host.publish(self.path, self.value)

    def _on_emergency(self, message: can.Message) -> None:
        if len(message.data) < 3:
            raise ValueError("not an emergency message")
        code = int.from_bytes(message.data[:2], "little")
        if code >> 8:
            text = f"{emergency(code)} (0x{code:04X})"
            self._emergencies[code] = text
        else:
            text = "error cleared"
            self._emergencies.clear()
        event = Emergency(code=code, text=text, active=bool(code >> 8))
        self._host.publish(f"event/{self._name}/emergency", event)
        self._host.publish(self.path, self.value)
