"""Whole frames in the tree, for ground stations that attach through the gateway."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_kernel.errors import DeviceRejected, InvalidValue
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress, check_fence
from rcp_mavlink.frames import Frame, Framer
from rcp_mavlink.hub import Hub
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Forwarding", "MavlinkFrame", "SentFrame", "asks_only"]

FRAMES, SEND, ASK = "event/mavlink/frame", "actuator/mavlink/frame", "service/mavlink/ask"
_MOST = 280  # bytes of a frame with its signature

_ASKING = frozenset({
    "LOG_REQUEST_DATA", "LOG_REQUEST_END", "LOG_REQUEST_LIST", "MISSION_ACK", "MISSION_REQUEST",
    "MISSION_REQUEST_INT", "MISSION_REQUEST_LIST", "MISSION_REQUEST_PARTIAL_LIST",
    "PARAM_EXT_REQUEST_LIST", "PARAM_EXT_REQUEST_READ", "PARAM_REQUEST_LIST",
    "PARAM_REQUEST_READ", "PING", "REQUEST_DATA_STREAM", "TIMESYNC",
})  # fmt: skip
"""Messages that change nothing on board but what the vehicle sends."""
_ASKING_COMMANDS = frozenset({510, 511, 512, 519, 520, 521, 522, 525, 527, 528, 2504, 2505})
"""GET_MESSAGE_INTERVAL, SET_MESSAGE_INTERVAL, REQUEST_MESSAGE, and the older requests for versions,
capabilities and what a camera has."""
_ASKING_FILES = bytes((1, 2, 3, 4, 5, 14, 15))
"""Operations of FILE_TRANSFER_PROTOCOL that only read: end and reset sessions, list, open to read,
read, checksum, burst read."""
_FTP_OPCODE = 3 + 3  # bytes into the payload: network, system, component, then sequence and session


class MavlinkFrame(Struct, frozen=True):
    """One frame that the vehicle sent."""

    message: str
    """Its name in the dialect."""
    system: int
    component: int
    data: bytes
    """The whole frame, with its signature if it has one."""


class SentFrame(Struct, frozen=True, forbid_unknown_fields=True):
    """One frame for the vehicle."""

    data: Annotated[bytes, Meta(min_length=8, max_length=_MOST)]


def asks_only(frame: Frame) -> bool:
    """Return whether a frame only makes the vehicle send something, and so moves nothing."""
    name = frame.definition.name
    if name in ("COMMAND_LONG", "COMMAND_INT"):
        return frame.fields()["command"] in _ASKING_COMMANDS
    if name == "FILE_TRANSFER_PROTOCOL":
        opcode = frame.payload[_FTP_OPCODE : _FTP_OPCODE + 1]  # 0 is cut off: it does nothing
        return not opcode or opcode in _ASKING_FILES
    return name in _ASKING


class Forwarding:
    """The frames of one vehicle: what it sends, and what ground stations send to it."""

    names = frozenset({FRAMES, SEND, ASK})

    def __init__(self, hub: Hub, vehicle: Vehicle) -> None:
        self._hub, self._vehicle = hub, vehicle
        self._framer = Framer(hub.dialect, None)

    def resources(self) -> list[Resource]:
        """List the resources, for configurations with `forward`."""
        return [
            Resource(
                name=FRAMES,
                description="Every frame of the vehicle, for ground stations behind the gateway.",
                value=MavlinkFrame,
                history=1,
            ),
            Resource(
                name=SEND,
                description="Send any frame to the vehicle, bypassing the limits of its other paths.",
                value=SentFrame,
                max_age=1.0,
            ),
            Resource(
                name=ASK,
                description="Send a frame that only asks the vehicle to send something.",
                input=SentFrame,
            ),
        ]

    def write(self, value: SentFrame) -> None:
        """Send a frame.

        :raises InvalidValue: it is not one whole frame of the dialect.
        """
        frame = self._frame(value.data)
        check_fence()
        self._hub.forward(self._vehicle, frame)

    async def ask(self, value: SentFrame, _: Progress) -> None:
        """Send a frame that asks.

        :raises DeviceRejected: it does more than that.
        """
        frame = self._frame(value.data)
        if not asks_only(frame):
            raise DeviceRejected(
                f"{frame.definition.name} does more than ask", remedy=f"Write it to {SEND}."
            )
        self._hub.forward(self._vehicle, frame)

    @contextmanager
    def watched(self, publish: Any) -> Generator[None]:
        """Publish every frame while entered: `publish` takes its value."""

        def tap(frame: Frame) -> None:
            publish(
                FRAMES,
                MavlinkFrame(frame.definition.name, frame.system, frame.component, frame.data),
            )

        self._vehicle.taps.append(tap)
        try:
            yield
        finally:
            self._vehicle.taps.remove(tap)

    def _frame(self, data: bytes) -> Frame:
        self._framer.reset()
        frames = self._framer.datagram(data)
        if len(frames) != 1 or len(frames[0].data) != len(data):
            raise InvalidValue(
                "not one whole MAVLink frame of the dialect with a right checksum",
                details={"pointer": "/data"},
            )
        self._check_meant(frames[0])
        return frames[0]

    def _check_meant(self, frame: Frame) -> None:
        """Refuse what another vehicle of the link might heed: that one has its own rights and stop.

        :raises InvalidValue: it is for another system, or for all where there are several.
        """
        fields, vehicles = frame.fields(), self._hub.vehicles
        to = fields.get("target_system", fields.get("target"))  # MANUAL_CONTROL says `target`
        alone = len(vehicles) <= 1
        if frame.system in vehicles:
            told = f"it says that it is from the vehicle {frame.system} itself"
        elif to is None:
            if alone or asks_only(frame):
                return
            told = "it is for no single vehicle, and there are several on the link"
        elif to == self._vehicle.system or (to == 0 and alone):
            return
        else:
            told = f"it is for system {to}, and this vehicle is {self._vehicle.system}"
        raise InvalidValue(
            f"{frame.definition.name} was not sent: {told}", details={"pointer": "/data"}
        )
