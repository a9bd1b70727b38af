"""Whatever comes over a link: whole frames are found, and nothing else gets through."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcp_mavlink.dialect import dialect
from rcp_mavlink.frames import Framer
from rcp_mavlink.signing import Signing, key_of

DIALECT = dialect("ardupilotmega")
M = DIALECT.module
KEY = key_of("a passphrase")


class _Out:
    def __init__(self) -> None:
        self.frames: list[bytes] = []

    def write(self, frame: bytes) -> None:
        self.frames.append(bytes(frame))


def packed(*messages: Any, signing: Signing | None = None, v1: bool = False) -> list[bytes]:
    out = _Out()
    mav = M.MAVLink(out, 7, 1)
    if signing is not None:
        signing.apply(mav, 0)
    for message in messages:
        mav.send(message, force_mavlink1=v1)
    return out.frames


def attitudes(count: int) -> list[Any]:
    return [M.MAVLink_attitude_message(n, 0.1, 0.2, 0.3, 0, 0, 0) for n in range(count)]


def test_values_arrive_in_the_units_of_the_tree() -> None:
    message = M.MAVLink_global_position_int_message(
        1500, -353632621, 1491652374, 584120, 10250, 150, -50, -25, 65535
    )
    (frame,) = Framer(DIALECT, None).datagram(packed(message)[0])
    value = frame.decode()
    assert value.lat == pytest.approx(-35.3632621)
    assert (value.time_boot_ms, value.alt, value.relative_alt) == (1.5, 584.12, 10.25)
    assert (value.vx, value.vy, value.vz) == pytest.approx((1.5, -0.5, -0.25))
    assert value.hdg is None, "UINT16_MAX means that it is not known"


def test_words_stand_for_the_numbers_of_an_enum() -> None:
    message = M.MAVLink_extended_sys_state_message(0, 2)
    (frame,) = Framer(DIALECT, None).datagram(packed(message)[0])
    assert frame.decode().landed_state == "in_air"


@pytest.mark.parametrize("v1", [False, True])
def test_a_stream_may_be_cut_anywhere(*, v1: bool) -> None:
    data = b"".join(packed(*attitudes(20), v1=v1))
    for size in (1, 7, 64):
        framer = Framer(DIALECT, None)
        found = [
            frame
            for at in range(0, len(data), size)
            for frame in framer.stream(data[at : at + size])
        ]
        assert [frame.fields()["time_boot_ms"] for frame in found] == list(range(20))
        assert (framer.stats.lost, framer.stats.bad) == (0, 0)


def test_what_is_missing_is_counted() -> None:
    frames = packed(*attitudes(10))
    framer = Framer(DIALECT, None)
    framer.stream(b"".join(frames[:3] + frames[6:]))
    assert framer.stats.lost == 3


@settings(max_examples=300)
@given(noise=st.lists(st.binary(max_size=300), min_size=2, max_size=6))
def test_between_garbage_whole_frames_are_found(noise: list[bytes]) -> None:
    frames = packed(*attitudes(len(noise)))
    framer = Framer(DIALECT, None)
    quiet = [bytes(b for b in part if b not in (0xFD, 0xFE)) for part in noise]
    data = b"".join(a + b for a, b in zip(quiet, frames, strict=True))
    found = framer.stream(data)
    assert [frame.data for frame in found] == frames
    assert framer.stats.bad == sum(map(len, quiet))


@settings(max_examples=300)
@given(noise=st.binary(max_size=2000))
def test_garbage_is_nothing_and_holds_nothing_up(noise: bytes) -> None:
    framer = Framer(DIALECT, None)
    assert all(frame.definition.id in DIALECT.by_id for frame in framer.stream(noise))
    after = packed(*attitudes(12))
    found = framer.stream(b"".join(after * 6))
    assert after[-1] in [frame.data for frame in found], "it has come to itself again"


@settings(max_examples=300)
@given(data=st.data())
def test_a_damaged_frame_never_gets_through(data: st.DataObject) -> None:
    (frame,) = packed(*attitudes(1))
    cut = data.draw(st.integers(1, len(frame) - 1))
    at = data.draw(st.integers(0, len(frame) - 1))
    flipped = data.draw(st.integers(1, 255))
    damaged = bytearray(frame)
    damaged[at] ^= flipped
    assert Framer(DIALECT, None).datagram(frame[:cut]) == []
    assert Framer(DIALECT, None).datagram(bytes(damaged)) == []


@settings(max_examples=200)
@given(at=st.integers(0, 60), flipped=st.integers(1, 255))
def test_only_what_is_signed_with_the_key_gets_through(at: int, flipped: int) -> None:
    framer = Framer(DIALECT, Signing(KEY))
    (unsigned,) = packed(*attitudes(1))
    (foreign,) = packed(*attitudes(1), signing=Signing(key_of("another")))
    (genuine,) = packed(*attitudes(1), signing=Signing(KEY))
    damaged = bytearray(genuine)
    damaged[at % len(damaged)] ^= flipped
    assert framer.datagram(unsigned) == framer.datagram(foreign) == []
    assert framer.datagram(bytes(damaged)) == []
    assert [frame.data for frame in framer.datagram(genuine)] == [genuine]
    assert framer.datagram(genuine) == [], "the same one a second time is a replay"
    assert framer.stats.frames == 1


def test_a_key_is_a_passphrase_or_written_in_hexadecimal() -> None:
    assert key_of("ab" * 32) == bytes([0xAB]) * 32
    assert len(key_of("short")) == 32


def test_every_message_of_the_dialect_has_a_type_and_a_value() -> None:
    for definition in DIALECT.by_id.values():
        value = definition.decode(b"\0" * definition.size)
        assert len(value.__struct_fields__) == len(definition.fields), definition.name


def test_angles_of_messages_are_radians() -> None:
    message = M.MAVLink_vfr_hud_message(5.0, 4.0, 90, 50, 584.0, 0.5)
    (frame,) = Framer(DIALECT, None).datagram(packed(message)[0])
    assert frame.decode().heading == pytest.approx(math.pi / 2)
    assert frame.decode().throttle == 0.5
