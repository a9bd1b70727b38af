"""What sets up a moteus: its configuration, as `moteus_tool --dump-config` has it, and its id."""

from __future__ import annotations

from collections.abc import Callable

from rcp_can.node_change import NodeChange
from rcp_can.profiles.moteus_stream import Stream
from rcp_can.settings import Setting, Settings, same
from rcp_kernel.errors import DeviceRejected

__all__ = ["MoteusSettings", "change_node"]

_STORES = 5.0  # s
_LIMITS = {
    "servo.max_current_A": Setting(0.0, 1000.0),
    "servo.max_voltage": Setting(0.0, 100.0),
    "servo.default_timeout_s": Setting(0.0, 3600.0),
    "servo.fault_temperature": Setting(0.0, 200.0),
    "motor.poles": Setting(0.0, 200.0, whole=True),
}
"""Bounds that the drive does not check itself; `nan`, for 'none', would lift them, and is refused."""
_OWN = Setting(writable=False)
_OWNED = "id", "can", "uuid"
"""Groups by which a drive is reached, or told from others."""


class MoteusSettings(Settings):
    """The configuration of one drive; which settings there are depends on its firmware."""

    saves = True
    step = 6e-7  # it tells six decimals

    def __init__(self, stream: Stream, node: int) -> None:
        self._stream, self._node = stream, node

    def setting(self, name: str) -> Setting:
        """Return what is known of a setting."""
        return _OWN if name.partition(".")[0] in _OWNED else _LIMITS.get(name, Setting())

    async def read_all(self, tell: Callable[[float], object]) -> dict[str, str]:
        """Read all."""
        lines = await self._stream.command("conf enumerate", node=self._node)
        words = (line.split(" ", 1) for line in lines)
        return {each[0]: each[1].strip() for each in words if len(each) == 2}

    async def read(self, name: str) -> str:
        """Read one."""
        return await self._stream.ask(f"conf get {name}", node=self._node)

    async def write(self, name: str, value: str) -> None:
        """Write one."""
        await self._stream.command(f"conf set {name} {value}", node=self._node)

    async def save(self) -> None:
        """Store all."""
        await self._stream.command("conf write", node=self._node, seconds=_STORES)


async def change_node(
    stream: Stream, current: int, wanted: NodeChange, begun: Callable[[], object]
) -> None:
    """Write the id, which is in force at once, read it back, and store all settings.

    :raises DeviceRejected: the drive keeps another one.
    """
    new = wanted.node
    begun()
    await stream.command(f"conf set id.id {new}", node=current, answers_as=new)
    kept = await stream.ask("conf get id.id", node=new)
    if not same(kept, str(new)):
        raise DeviceRejected(f"the drive kept the id {kept} instead of {new}")
    await stream.command("conf write", node=new, seconds=_STORES)
