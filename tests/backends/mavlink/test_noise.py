"""Garbage, pieces, foreign keys and nonsense never crash the backend, stall it or reach the tree."""

from __future__ import annotations

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mav

from backends.mavlink.puppet import Puppet, Station, station
from rcp_gateway.testing import eventually
from rcp_mavlink.dialect import dialect
from rcp_mavlink.signing import Signing, key_of

DIALECT = dialect("ardupilotmega")
NUMBERS = sorted(DIALECT.by_id)


class Out:
    """Packs messages, also with payloads that nobody would make."""

    def __init__(self, key: str | None = None) -> None:
        self.frame = b""
        self.mav: Any = mav.MAVLink(self, 1, 1)
        if key is not None:
            Signing(key_of(key)).apply(self.mav, 0)

    def write(self, frame: bytes) -> None:
        self.frame = bytes(frame)

    def packed(self, message: Any) -> bytes:
        self.mav.send(message)
        return self.frame

    def raw(self, number: int, payload: bytes) -> bytes:
        """Return a frame that is right in everything but what it says."""
        definition = DIALECT.by_id[number]
        payload = payload[: definition.size] or b"\0"
        head = bytes((len(payload), 0, 0, self.mav.seq & 0xFF, 1, 1)) + number.to_bytes(3, "little")
        self.mav.seq += 1
        crc = mav.x25crc(head + payload + bytes((definition.crc_extra,))).crc
        return b"\xfd" + head + payload + crc.to_bytes(2, "little")


def attitude(roll: float) -> Any:
    return mav.MAVLink_attitude_message(5, roll, 0, 0, 0, 0, 0)


async def alive(found: Station, puppet: Puppet) -> None:
    """See that what the vehicle says still comes through, and that it can be told."""
    puppet.armed = not puppet.armed

    async def seen() -> bool:
        return (await found.read("sensor/armed")) is puppet.armed

    await eventually(seen, "it is heard as ever")


async def test_garbage_and_pieces_of_frames_are_nothing() -> None:
    puppet, out = Puppet(), Out()
    async with station(puppet, params=[]) as found:
        (link,) = found.served.life.backend.hub.links
        whole = out.packed(attitude(0.5))
        before = found.robot.vehicle.latest.get("ATTITUDE")
        reports = set(found.served.life.backend.robots)

        @settings(max_examples=400)
        @given(
            noise=st.binary(max_size=400),
            cut=st.integers(0, len(whole) - 1),
            flip=st.integers(1, 255),
        )
        def feed(noise: bytes, cut: int, flip: int) -> None:
            broken = bytearray(whole)
            broken[cut] ^= flip
            for data in (noise, whole[:cut], bytes(broken), noise + whole[:cut] + noise):
                link.datagram(None, data)

        feed()
        assert found.robot.vehicle.latest.get("ATTITUDE") is before
        assert set(found.served.life.backend.robots) == reports

        async def told() -> bool:
            (state,) = await found.read("sensor/links")
            return state["bad"] > 0 and state["unknown"] > 0

        await eventually(told, "it is counted")
        await alive(found, puppet)


async def test_frames_that_say_nonsense_are_borne() -> None:
    puppet, out = Puppet(), Out()
    puppet.params = {"RTL_ALT": (1500.0, 4)}
    async with station(puppet, messages=["*"]) as found:
        (link,) = found.served.life.backend.hub.links
        robot = found.robot
        await eventually(lambda: _is(robot.parameters.complete.is_set()), "they are listed")
        for name in ("attitude", "gps", "battery"):
            await found.client.subscribe(f"/tenant/t/sensor/{name}")

        @settings(max_examples=600)
        @given(number=st.sampled_from(NUMBERS), payload=st.binary(max_size=255))
        def feed(number: int, payload: bytes) -> None:
            if number not in (0, 33):  # those would be believed: it is the vehicle that says them
                link.datagram(None, out.raw(number, payload))

        feed()
        for number in (0, 1, 22, 30, 33, 42, 46, 111, 242, 245, 253):
            for payload in (b"\xff" * 255, b"\x80" * 255, b"\0"):
                link.datagram(None, out.raw(number, payload))
        for type_ in range(12):
            for bits in (b"\0\0\xc0\x7f", b"\0\0\x80\xff", b"\xff\xff\xff\xff"):
                ends = (1).to_bytes(2, "little") + bytes(2) + b"RTL_ALT".ljust(16, b"\0")
                link.datagram(None, out.raw(22, bits + ends + bytes((type_,))))
        await alive(found, puppet)


async def test_what_is_not_signed_with_the_key_changes_nothing_and_is_counted() -> None:
    puppet = Puppet()
    Signing(key_of("ours")).apply(puppet.out, 0)
    unsigned, foreign = Out(), Out("theirs")
    async with station(puppet, key="ours", params=[]) as found:
        (link,) = found.served.life.backend.hub.links
        count = 0

        @settings(max_examples=150)
        @given(roll=st.floats(-1, 1), armed=st.booleans())
        def feed(roll: float, armed: bool) -> None:  # noqa: FBT001
            nonlocal count
            beat = mav.MAVLink_heartbeat_message(2, 3, 128 if armed else 0, 9, 4, 3)
            for out in (unsigned, foreign):
                for message in (attitude(roll), beat):
                    link.datagram(None, out.packed(message))
            count += 2

        feed()
        assert "ATTITUDE" not in found.robot.vehicle.latest
        assert found.robot.vehicle.mode == "STABILIZE"

        async def told() -> bool:
            (state,) = await found.read("sensor/links")
            return (state["unsigned"], state["rejected"]) == (count, count)

        await eventually(told, "both are counted")
        await alive(found, puppet)


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
