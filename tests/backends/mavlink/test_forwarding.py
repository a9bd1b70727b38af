"""Which frames of a ground station only ask, and how frames are rebuilt for a signed link."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from rcp_kernel.errors import DeviceRejected, InvalidValue
from rcp_mavlink.dialect import dialect
from rcp_mavlink.forwarding import Forwarding, SentFrame, asks_only
from rcp_mavlink.frames import Frame, Framer, rebuilt
from rcp_mavlink.signing import Signing, key_of

MESSAGES = dialect("ardupilotmega")
M = MESSAGES.module


class Sink:
    """Takes the bytes of a message."""

    data = b""

    def write(self, data: bytes) -> None:
        self.data = bytes(data)


def packed(message: Any, *, old: bool = False) -> bytes:
    """Return a message as a ground station sends it."""
    sink = Sink()
    M.MAVLink(sink, 245, 190).send(message, force_mavlink1=old)
    return sink.data


def frame(message: Any) -> Frame:
    """Return a message as it is received."""
    (found,) = Framer(MESSAGES, None).datagram(packed(message))
    return found


def command(number: int) -> Any:
    """Return a command."""
    return M.MAVLink_command_long_message(1, 1, number, 0, *[0.0] * 7)


def file(opcode: int) -> Any:
    """Return a request about files."""
    return M.MAVLink_file_transfer_protocol_message(
        0, 1, 1, bytes((1, 0, 0, opcode)).ljust(251, b"\0")
    )


@pytest.mark.parametrize(
    "message",
    [
        M.MAVLink_param_request_list_message(1, 1),
        M.MAVLink_mission_request_list_message(1, 1, 0),
        M.MAVLink_timesync_message(0, 5),
        command(512),  # REQUEST_MESSAGE
        command(511),  # SET_MESSAGE_INTERVAL
        file(4),  # open to read
        file(15),  # burst read
    ],
)
def test_what_only_asks(message: Any) -> None:
    assert asks_only(frame(message))


@pytest.mark.parametrize(
    "message",
    [
        command(400),  # COMPONENT_ARM_DISARM
        command(526),  # STORAGE_FORMAT
        command(246),  # PREFLIGHT_REBOOT_SHUTDOWN
        M.MAVLink_param_set_message(1, 1, b"FS_GCS_ENABLE", 0.0, 9),
        M.MAVLink_set_mode_message(1, 1, 4),
        M.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0),
        M.MAVLink_rc_channels_override_message(1, 1, *[1500] * 8),
        M.MAVLink_mission_count_message(1, 1, 3, 0),
        M.MAVLink_set_position_target_local_ned_message(0, 1, 1, 8, 0xDC7, *[0.0] * 11),
        M.MAVLink_serial_control_message(10, 0, 0, 0, 1, b"x".ljust(70, b"\0")),
        file(6),  # create
        file(8),  # remove
    ],
)
def test_what_does_more(message: Any) -> None:
    assert not asks_only(frame(message))


@pytest.mark.parametrize("old", [False, True])
def test_a_frame_is_signed_for_the_vehicle_and_stays_the_same(*, old: bool) -> None:
    signing = Signing(key_of("secret"))
    data = packed(M.MAVLink_param_set_message(1, 1, b"RTL_ALT", 25.0, 9), old=old)
    (first,) = Framer(MESSAGES, None).datagram(data)
    receiver = Framer(MESSAGES, Signing(key_of("secret")))
    found = first
    for _ in range(3):  # each signature is later than the one before
        (found,) = receiver.datagram(rebuilt(first, signing, 2))
        assert (found.system, found.component) == (245, 190)
        assert found.fields() == first.fields()
    assert Framer(MESSAGES, Signing(key_of("other"))).datagram(rebuilt(first, signing, 2)) == []
    (bare,) = Framer(MESSAGES, None).datagram(rebuilt(found, None, 0))
    assert bare.fields() == first.fields()


VEHICLE: Any = SimpleNamespace(system=1)


class Hub:
    """Keeps what would be sent."""

    dialect = MESSAGES

    def __init__(self, *others: int) -> None:
        self.vehicles: dict[int, Any] = dict.fromkeys((1, *others))
        self.sent: list[Frame] = []

    def forward(self, _vehicle: Any, frame: Frame) -> None:
        self.sent.append(frame)


@pytest.mark.parametrize(
    "data",
    [
        b"\0" * 12,
        packed(command(400))[:-1],
        packed(command(400)) + b"\0",
        packed(command(400)) * 2,
        packed(command(400))[:-2] + b"\0\0",
    ],
)
def test_what_is_not_one_whole_frame_goes_nowhere(data: bytes) -> None:
    hub: Any = Hub()
    with pytest.raises(InvalidValue):
        Forwarding(hub, VEHICLE).write(SentFrame(data))
    assert hub.sent == []


@pytest.mark.anyio
async def test_asking_moves_nothing() -> None:
    hub: Any = Hub()
    forwarding = Forwarding(hub, VEHICLE)
    with pytest.raises(DeviceRejected):
        await forwarding.ask(SentFrame(packed(command(400))), None)  # pyright: ignore[reportArgumentType] - not used
    assert hub.sent == []
    await forwarding.ask(SentFrame(packed(command(512))), None)  # pyright: ignore[reportArgumentType] - not used
    assert [one.definition.name for one in hub.sent] == ["COMMAND_LONG"]


def for_system(number: int) -> bytes:
    """Return a command for a vehicle."""
    return packed(M.MAVLink_command_long_message(number, 1, 400, 0, 1.0, *[0.0] * 6))


@pytest.mark.parametrize(
    "data",
    [for_system(2), for_system(0), packed(M.MAVLink_set_gps_global_origin_message(0, 0, 0, 0))],
)
def test_what_another_vehicle_of_the_link_might_heed_goes_nowhere(data: bytes) -> None:
    hub: Any = Hub(2)
    with pytest.raises(InvalidValue, match="was not sent"):
        Forwarding(hub, VEHICLE).write(SentFrame(data))
    assert hub.sent == []
    Forwarding(hub, VEHICLE).write(SentFrame(for_system(1)))
    assert len(hub.sent) == 1


def test_nobody_speaks_as_the_vehicle_itself() -> None:
    hub: Any = Hub()
    sink = Sink()
    M.MAVLink(sink, 1, 1).send(command(400))
    with pytest.raises(InvalidValue, match="itself"):
        Forwarding(hub, VEHICLE).write(SentFrame(sink.data))
    Forwarding(hub, VEHICLE).write(SentFrame(for_system(0)))  # to all, and there is one
    assert len(hub.sent) == 1
