"""Every payload comes back as it went, keeps to its ends, and no frame upsets anybody."""

from __future__ import annotations

import asyncio
import contextlib
import math
import struct
from typing import Any

import can
import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from backends.can.rig import MOTORS, OTHERS
from rcp_can.codec import Codec, Field, Layout, Packed, Span
from rcp_can.config import BusConfig
from rcp_can.profiles import (
    PROFILES,
    cia402_objects,
    cybergear,
    mit,
    odrive_messages,
    profile,
    vesc,
)
from rcp_can.profiles import moteus_wire as wire
from rcp_can.profiles.cia402_objects import state_of
from rcp_can.sdo import Sdo, SdoAborted
from rcp_can.sim import make_twin
from rcp_kernel.errors import DeviceTimeout, RcpError

CODECS: dict[str, Codec] = {
    **{f"odrive {name}": layout for name, (_, layout) in odrive_messages.MESSAGES.items()},
    **{f"cia402 {name}": layout for name, (_, layout) in cia402_objects.MESSAGES.items()},
    **{f"vesc {name}": layout for name, (_, layout) in vesc.MESSAGES.items()},
    **{f"command {name}": mit.command_codec(span) for name, span in mit.MODELS.items()},
    **{f"reply {name}": mit.reply_codec(span) for name, span in mit.MODELS.items()},
    "cybergear command": cybergear.COMMAND,
    "cybergear torque": cybergear.TORQUE,
    "cybergear feedback": cybergear.FEEDBACK,
}


def ends(codec: Codec) -> dict[str, tuple[float, float, float]]:
    """Return each field's lowest and highest value, and how fine it is."""
    found: dict[str, tuple[float, float, float]] = {}
    if isinstance(codec, Packed):
        for span in codec.spans:
            low, high = span.low, span.high
            if low is None or high is None:
                found[span.name] = 0, (1 << span.bits) - 1, 0.5
            else:
                found[span.name] = low, high, (high - low) / ((1 << span.bits) - 1) * 0.501
        return found
    assert isinstance(codec, Layout)
    for field in codec.fields:
        if field.code == "f":
            found[field.name] = -1e6, 1e6, 0.2 * field.scale
        else:
            bits = 8 * struct.calcsize(field.code)
            low = -(2 ** (bits - 1)) if field.code.islower() else 0
            high = low + 2**bits - 1
            found[field.name] = low * field.scale, high * field.scale, 0.501 * field.scale
    return found


@pytest.mark.parametrize("name", CODECS)
@given(data=st.data())
@settings(max_examples=30)
def test_values_come_back_within_half_a_step(name: str, data: st.DataObject) -> None:
    codec = CODECS[name]
    values: dict[str, float] = {}
    for field, (low, high, _) in ends(codec).items():
        values[field] = data.draw(st.floats(low, high))
    found = codec.decode(codec.encode(**values))
    for field, (_, _, fine) in ends(codec).items():
        assert abs(found[field] - values[field]) <= fine, field


@pytest.mark.parametrize("name", CODECS)
def test_the_ends_of_a_range_are_reached_and_never_passed(name: str) -> None:
    codec = CODECS[name]
    for field, (low, high, fine) in ends(codec).items():
        for value, end in ((low, low), (high, high)):
            assert abs(codec.decode(codec.encode(**{field: value}))[field] - end) <= fine
        if not isinstance(codec, Layout) or all(f.code != "f" for f in codec.fields):
            for beyond, end in ((low - 1e9, low), (high + 1e12, high), (math.inf, high)):
                assert abs(codec.decode(codec.encode(**{field: beyond}))[field] - end) <= fine


@pytest.mark.parametrize("name", CODECS)
@given(data=st.data())
@settings(max_examples=20)
def test_any_bytes_are_values_or_refused_and_go_back_as_they_came(
    name: str, data: st.DataObject
) -> None:
    codec = CODECS[name]
    raw = data.draw(st.binary(min_size=codec.size, max_size=codec.size))
    try:
        values = codec.decode(raw)
    except ValueError:
        assert isinstance(codec, Layout)  # a float that is not finite
        return
    assert all(math.isfinite(value) for value in values.values())
    if isinstance(codec, Packed):
        assert codec.encode(**values) == raw
    for size in range(codec.size):
        with pytest.raises(ValueError, match="expected"):
            codec.decode(raw[:size])


@pytest.mark.parametrize("name", CODECS)
def test_what_is_not_a_number_is_refused(name: str) -> None:
    codec = CODECS[name]
    for field in codec.names:
        with pytest.raises(ValueError, match="not a number"):
            codec.encode(**{field: math.nan})
    with pytest.raises(ValueError, match="no field"):
        codec.encode(nonsense=1)


def test_a_packed_payload_fills_whole_bytes() -> None:
    with pytest.raises(ValueError, match="whole number of bytes"):
        Packed(Span("a", 7))


def test_a_float_that_may_be_missing_is_nan() -> None:
    layout = Layout("<", Field("a", "f", nan=True))
    assert math.isnan(layout.decode(layout.encode(a=math.nan))["a"])


class NoBus:
    """A bus that takes everything and has nobody on it."""

    name, up, state = "none", True, "error_active"
    lag = 0.0
    config = BusConfig()

    def received_at(self, _: can.Message) -> float:
        return 0.0

    def send(self, *_: Any, **__: Any) -> None:
        """Drop it."""

    def paced(self, *_: Any) -> bool:
        return True

    def shared(self, _: type, make: Any) -> Any:
        return make(self)

    def listen(self, *_: Any) -> None:
        """Hear nothing."""


frames = st.builds(
    can.Message,
    arbitration_id=st.integers(0, 0x7FF),
    data=st.binary(max_size=8),
    is_extended_id=st.just(False),
)


@pytest.mark.parametrize("name", PROFILES)
@given(data=st.data())
@settings(max_examples=60)
def test_no_frame_upsets_a_drive_or_its_twin(name: str, data: st.DataObject) -> None:
    kind, table = profile(name), (MOTORS | OTHERS)[name]
    bus: Any = NoBus()
    drive = kind.drive(table["node"], msgspec.convert(table.get("options", {}), kind.options), bus)
    twin = make_twin(name, table["node"], **table.get("options", {}))
    for _ in range(4):
        route = data.draw(st.sampled_from(drive.routes()))
        free = data.draw(st.integers(0, 0x1FFFFFFF if route.extended else 0x7FF))
        message = can.Message(
            arbitration_id=route.value | (free & ~route.mask),
            is_extended_id=route.extended,
            data=data.draw(st.binary(max_size=8)),
        )
        try:
            drive.take(message)
        except ValueError:
            continue
    status = drive.status
    for value in (status.position, status.velocity, status.torque):
        assert value is None or math.isfinite(value)
    twin.take(data.draw(frames))
    extended = data.draw(st.integers(0, 0x1FFFFF)) << 8 | table["node"]
    size = data.draw(st.binary(max_size=8))
    twin.take(can.Message(arbitration_id=extended, is_extended_id=True, data=size))
    twin.tick(1.0)


@given(st.integers(0, 0xFFFF))
def test_any_statusword_is_a_state(word: int) -> None:
    assert isinstance(state_of(word), str)


def test_the_states_of_the_standard_are_told_apart() -> None:
    words = {0x250: "switch_on_disabled", 0x231: "ready", 0x233: "switched_on", 0x237: "enabled"}
    words |= {0x217: "quick_stop", 0x21F: "fault_reaction", 0x218: "fault", 0x200: "not_ready"}
    for word, state in words.items():
        assert state_of(word) == state


accesses = st.lists(
    st.builds(
        wire.Access,
        st.sampled_from([wire.Kind.WRITE, wire.Kind.REPLY]),
        st.sampled_from([register.number for register in wire.REGISTERS.values()]),
        st.sampled_from(wire.Width),
        st.floats(-0.25, 0.25, width=32),
    ),
    max_size=8,
)


@given(accesses)
def test_moteus_registers_come_back_as_they_went(sent: list[wire.Access]) -> None:
    found = wire.parse(wire.pad(wire.build(sent)))
    assert [(a.kind, a.register, a.width) for a in found] == [
        (a.kind, a.register, a.width) for a in sent
    ]
    for one, other in zip(sent, found, strict=True):
        scale = 1e-6 if one.width == wire.Width.FLOAT else wire.step(one.register, one.width)
        assert abs((one.value or 0) - (other.value or 0)) <= 0.501 * scale


@given(st.binary(max_size=64))
def test_any_moteus_payload_is_registers_or_refused(data: bytes) -> None:
    try:
        found = wire.parse(data)
    except ValueError:
        return
    assert all(isinstance(access, wire.Access) for access in found)


def test_a_moteus_value_that_is_missing_is_nan_in_every_width() -> None:
    for width in wire.Width:
        sent = wire.Access(wire.Kind.WRITE, 0x020, width, math.nan)
        (found,) = wire.parse(wire.build([sent]))
        assert found.value is not None
        assert math.isnan(found.value)
        beyond = wire.Access(wire.Kind.WRITE, 0x020, width, 1e30)
        (found,) = wire.parse(wire.build([beyond]))
        assert found.value is not None
        assert found.value > 1.0


@given(st.lists(st.binary(max_size=8), max_size=8))
async def test_no_answer_upsets_the_sdo_client(answers: list[bytes]) -> None:
    bus: Any = NoBus()
    sdo = Sdo(bus, 5)
    asking = asyncio.ensure_future(sdo.upload(0x1000))
    for answer in answers:
        await asyncio.sleep(0)
        with contextlib.suppress(ValueError):
            sdo.take(can.Message(arbitration_id=0x585, data=answer, is_extended_id=False))
    await asyncio.sleep(0)
    asking.cancel()
    with contextlib.suppress(asyncio.CancelledError, RcpError):
        assert isinstance(await asking, bytes)


@given(st.lists(st.binary(min_size=1, max_size=7), min_size=1, max_size=4))
async def test_a_segmented_upload_is_the_bytes_that_were_sent(parts: list[bytes]) -> None:
    whole = b"".join(part.ljust(7, b".") for part in parts[:-1]) + parts[-1]
    frames = [struct.pack("<BHBI", 0x41, 0x2000, 0, len(whole))]
    for number, start in enumerate(range(0, len(whole), 7)):
        piece = whole[start : start + 7]
        last = start + 7 >= len(whole)
        head = (number % 2) << 4 | (7 - len(piece)) << 1 | last
        frames.append(bytes((head,)) + piece.ljust(7, b"\0"))
    bus: Any = NoBus()
    sdo = Sdo(bus, 5)
    asking = asyncio.ensure_future(sdo.upload(0x2000))
    for frame in frames:
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        sdo.take(can.Message(arbitration_id=0x585, data=frame, is_extended_id=False))
    assert await asking == whole


VALUE = struct.pack("<BHBI", 0x43, 0x605A, 0, 2)


@pytest.mark.parametrize(
    "stale",
    [
        struct.pack("<BHBI", 0x43, 0x6007, 0, 9),
        struct.pack("<BHBI", 0x43, 0x605A, 1, 9),
        struct.pack("<BHBI", 0x60, 0x605A, 0, 0),
        struct.pack("<BHBI", 0x80, 0x6007, 0, 0x06020000),
        bytes(8),
    ],
    ids=["object", "subindex", "download", "abort", "segment"],
)
async def test_a_late_response_to_another_request_is_neither_the_answer_nor_an_end(
    stale: bytes,
) -> None:
    bus: Any = NoBus()
    sdo = Sdo(bus, 5)
    asking = asyncio.ensure_future(sdo.upload(0x605A))
    for frame in (stale, VALUE):
        await asyncio.sleep(0)
        sdo.take(can.Message(arbitration_id=0x585, data=frame, is_extended_id=False))
    assert await asking == struct.pack("<I", 2)


async def test_a_node_that_answers_another_request_alone_is_late_and_the_reason_is_told() -> None:
    bus: Any = NoBus()
    sdo = Sdo(bus, 5)
    asking = asyncio.ensure_future(sdo.upload(0x6007))
    await asyncio.sleep(0)
    sdo.take(can.Message(arbitration_id=0x585, data=VALUE, is_extended_id=False))
    with pytest.raises(DeviceTimeout, match="0x6007:00, but to another request"):
        await asking


async def test_a_busy_node_that_answers_a_request_later_is_not_two_nodes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcp_can.sdo._TIMEOUT", 0.02)
    bus: Any = NoBus()
    sdo = Sdo(bus, 5)
    with pytest.raises(DeviceTimeout):
        await sdo.upload(0x605A)
    monkeypatch.setattr("rcp_can.sdo._TIMEOUT", 0.5)
    answer = can.Message(arbitration_id=0x585, data=VALUE, is_extended_id=False)
    asking = asyncio.ensure_future(sdo.upload(0x605A))
    await asyncio.sleep(0)
    sdo.take(answer)  # to the first request
    await asking
    sdo.take(answer)  # to the second
    assert sdo.unasked == 0
    sdo.take(answer)  # to none
    assert sdo.unasked == 1


async def test_what_a_node_owes_for_long_is_not_expected_any_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcp_can.sdo._TIMEOUT", 0.02)
    bus: Any = NoBus()
    sdo = Sdo(bus, 5)
    with pytest.raises(DeviceTimeout):
        await sdo.upload(0x605A)
    monkeypatch.setattr("rcp_can.sdo._TIMEOUT", 0.5)
    monkeypatch.setattr("rcp_can.sdo._OWES", 0.0)
    answer = can.Message(arbitration_id=0x585, data=VALUE, is_extended_id=False)
    asking = asyncio.ensure_future(sdo.upload(0x605A))
    await asyncio.sleep(0)
    sdo.take(answer)
    await asking
    sdo.take(answer)  # of a second node
    assert sdo.unasked == 1


async def test_an_abort_of_the_pending_request_ends_it() -> None:
    bus: Any = NoBus()
    sdo = Sdo(bus, 5)
    asking = asyncio.ensure_future(sdo.upload(0x605A))
    await asyncio.sleep(0)
    abort = struct.pack("<BHBI", 0x80, 0x605A, 0, 0x06020000)
    sdo.take(can.Message(arbitration_id=0x585, data=abort, is_extended_id=False))
    with pytest.raises(SdoAborted, match="0x605A:00: the object does not exist"):
        await asking
