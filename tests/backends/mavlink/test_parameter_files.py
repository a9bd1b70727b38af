"""Parameter files: saved, compared, loaded as a whole or not at all, and reset."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest

from backends.mavlink.puppet import PX4, Puppet, station
from backends.mavlink.test_gateway import Pilot, flying
from rcp_gateway.testing import eventually
from rcp_kernel.errors import DeviceRejected, UnknownPath
from rcp_mavlink.parameter_defaults import unpacked
from rcp_mavlink.parameter_files import FORMATS, Entry, Row, checked, is_state, parsed
from rcp_mavlink.reversal import reversed_on_failure
from rcp_mavlink_sim.parameters_table import table

WHOLE = 1300  # parameters, as many as an ArduCopter has
REAL, INT8, UINT8, UINT32 = 9, 2, 1, 5
STATE = {"MIS_TOTAL": 5, "STAT_RUNTIME": 1000, "BARO1_GND_PRESS": 95_000, "SYSID_SW_MREV": 120}


@pytest.fixture
async def pilot() -> AsyncIterator[Pilot]:
    more = {f"TEST_{n}": 0.1 * n for n in range(WHOLE)}
    async with flying({"parameters": {"DISARM_DELAY": 0.0, **more}}, params=["RTL_*"]) as found:
        await found.ready()
        yield found


async def exported(pilot: Pilot, form: str = "param") -> str:
    reply = await pilot.do("service/param/export", {"format": form})
    assert reply["status"] == "completed", reply
    assert reply["body"]["count"] == len(pilot.vehicle.params)
    return reply["body"]["text"]


def changed(text: str, **values: float) -> str:
    lines = [line.split(",") for line in text.splitlines()]
    return "".join(f"{name},{values.get(name, value)}\n" for name, value in lines)


TEN = {f"TEST_{n}": 7.25 + n for n in range(8)} | {"RTL_ALT": 2500, "FENCE_ENABLE": 1}


@pytest.mark.parametrize("form", ["param", "params"])
async def test_a_whole_file_is_saved_changed_in_ten_places_loaded_and_verified(
    pilot: Pilot, form: str
) -> None:
    params = pilot.vehicle.params
    assert len(params) > WHOLE
    before = {name: params[name] for name in params.listed()}
    text = changed(await exported(pilot), **TEN)
    if form == "params":
        rows = [Row(name, float(value), REAL) for name, value in _pairs(text)]
        text = FORMATS["params"](rows, 1, 1)
    compared = (await pilot.do("service/param/compare", {"text": text}))["body"]
    assert {d["name"]: d["file"] for d in compared["differences"]} == TEN
    assert (compared["same"], compared["unknown"], compared["absent"]) == (len(params) - 10, [], 0)
    loaded = await pilot.do("action/param/load", {"text": text})
    assert loaded["status"] == "completed", loaded
    body = loaded["body"]
    assert {d["name"]: d["file"] for d in body["written"]} == TEN
    assert {d["name"]: d["vehicle"] for d in body["written"]} == {n: before[n] for n in TEN}
    assert all(map(is_state, body["skipped"]))
    assert body["unchanged"] == len(params) - 10 - len(body["skipped"])
    assert {name: params[name] for name in params.listed()} == before | TEN
    assert await pilot.read("param/RTL_ALT") == 2500
    assert changed(await exported(pilot), **TEN) == await exported(pilot)


def _pairs(text: str) -> list[tuple[str, str]]:
    return [(name, value) for name, _, value in (x.partition(",") for x in text.splitlines())]


BAD = """# a comment
RTL_ALT,high
NO_SUCH,1
FENCE_ENABLE,1.5
FENCE_ENABLE,1.5
DISARM_DELAY,1000
RTL_SPEED 100 200
RTL_LOIT_TIME\t5000
RTL_LOIT_TIME,5001
a-b,1
FENCE_RADIUS,inf
"""


async def test_a_bad_file_is_refused_as_a_whole_with_each_line_and_reason(pilot: Pilot) -> None:
    before = await exported(pilot)
    reply = await pilot.do("action/param/load", {"text": BAD + "RTL_ALT_FINAL,300\n"})
    assert reply["status"] == "rejected"
    error = reply["error"]
    assert error["code"] == "invalid_value"
    assert error["details"]["pointer"] == "/text"
    assert {each["line"]: each["reason"] for each in error["details"]["lines"]} == {
        2: "RTL_ALT: 'high' is not a number",
        3: "the vehicle has no parameter NO_SUCH",
        4: "FENCE_ENABLE must be a whole number, and is 1.5",
        6: "DISARM_DELAY must be -128 to 127",
        7: "expected NAME,VALUE, or QGroundControl's five columns separated by tabs",
        9: "RTL_LOIT_TIME has another value in line 8",
        10: "'a-b' cannot be the name of a parameter",
        11: "FENCE_RADIUS: 'inf' is not a number",
    }
    assert reply["message"].startswith("line 2: RTL_ALT: 'high' is not a number; line 3:")
    assert reply["message"].endswith("; and 5 more")
    assert await exported(pilot) == before


async def test_parameters_of_other_firmware_are_skipped_if_wanted(pilot: Pilot) -> None:
    given = {"text": "NO_SUCH,1\nRTL_ALT,2000\n", "skip_unknown": True}
    body = (await pilot.do("action/param/load", given))["body"]
    assert body["skipped"] == ["NO_SUCH"]
    assert [each["name"] for each in body["written"]] == ["RTL_ALT"]
    assert pilot.vehicle.params["RTL_ALT"] == 2000


async def test_what_the_vehicle_keeps_itself_is_not_written() -> None:
    async with flying({"parameters": STATE}) as pilot:
        await pilot.ready()
        text = "".join(f"{name},{value + 1}\n" for name, value in STATE.items())
        reply = await pilot.do("action/param/load", {"text": text + "RTL_ALT,2000\n"})
        assert reply["status"] == "completed", reply
        assert reply["body"]["skipped"] == list(STATE)
        assert [each["name"] for each in reply["body"]["written"]] == ["RTL_ALT"]
        assert {name: pilot.vehicle.params[name] for name in STATE} == STATE


class Stubborn(Puppet):
    """Refuses B, and takes A once."""

    def __init__(self) -> None:
        super().__init__()
        self.params = {"A": (1.0, REAL), "B": (2.0, REAL), "C": (3.0, REAL)}
        self.set = 0
        self.on["PARAM_SET"] = self.keep

    def keep(self, message: Any) -> None:
        if message.param_id == "A":
            self.set += 1
            self.params["A"] = (message.param_value if self.set == 1 else 1.5, REAL)
        self.tell(message.param_id)


async def test_what_is_not_as_before_after_it_was_put_back_is_told() -> None:
    async with station(Stubborn()) as scene:
        reply = await scene.do("action/param/load", {"text": "A,9\nB,9\n"})
        assert reply["error"]["code"] == "device_rejected"
        assert reply["message"].endswith("could not be put back: A (it is 1.5, and was 1)"), reply


async def test_a_vehicle_that_does_not_respond_is_not_asked_for_ever() -> None:
    """Between a load that fails and its end: a thousand parameters would take half an hour."""
    puppet = Puppet()
    puppet.params = {f"P{n}": (0.0, REAL) for n in range(9)}
    asked: list[str] = []

    def mute(message: Any) -> None:
        asked.append(message.param_id)
        if len(asked) < 9:
            puppet.params[message.param_id] = (message.param_value, REAL)
            puppet.tell(message.param_id)

    puppet.on["PARAM_SET"] = mute
    async with station(puppet, retries=0) as scene:
        text = "".join(f"P{n},1\n" for n in range(9))
        reply = await scene.do("action/param/load", {"text": text})
        assert reply["status"] == "failed"
        assert reply["message"].endswith(f"put back: {', '.join(puppet.params)}"), reply
        assert asked == [*puppet.params, "P8", "P7", "P6"]


async def test_nothing_keeps_it_from_being_put_back() -> None:
    """Neither a second cancel nor an error that nobody expects."""
    begun, go, ended = asyncio.Event(), asyncio.Event(), asyncio.Event()

    async def put_back() -> str:
        begun.set()
        await go.wait()
        ended.set()
        return "all is as before"

    async def work() -> None:
        async with reversed_on_failure(put_back):
            raise ValueError("odd")

    for cancels in (0, 2):
        for event in (begun, go, ended):
            event.clear()
        task = asyncio.create_task(work())
        await begun.wait()
        for _ in range(cancels):
            task.cancel()
            await asyncio.sleep(0)
        assert not task.done()
        go.set()
        with pytest.raises(asyncio.CancelledError if cancels else DeviceRejected) as told:
            await task
        assert ended.is_set()
        assert cancels or str(told.value).endswith("ValueError('odd'); all is as before")


@pytest.mark.parametrize(("line", "file"), [("A,1e39", 1e39), ("B,300", 300), ("B,0.5", 0.5)])
async def test_what_cannot_be_of_its_type_differs(line: str, file: float) -> None:
    puppet = Puppet(autopilot=PX4)
    puppet.params = {"A": (1.0, REAL), "B": (2, UINT8)}
    async with station(puppet) as scene:
        body = (await scene.do("service/param/compare", {"text": line}))["body"]
        assert [(d["name"], d["file"]) for d in body["differences"]] == [(line[0], file)]


async def test_the_checksum_of_px4_is_no_parameter() -> None:
    puppet = Puppet(autopilot=PX4)
    puppet.params = {"A": (1.0, REAL), "B": (2, UINT8)}

    def checksum(m: Any) -> None:
        if m.param_id == "_HASH_CHECK":
            puppet.send("PARAM_VALUE", b"_HASH_CHECK", 0.0, UINT32, 2, 65535)
        else:
            puppet.tell(m.param_id)

    def all_of_them(_: Any) -> None:
        puppet.send("PARAM_VALUE", b"_HASH_CHECK", 0.0, UINT32, 2, 65535)
        puppet.tell("A")
        puppet.tell("B")

    puppet.on.update(PARAM_REQUEST_LIST=all_of_them, PARAM_REQUEST_READ=checksum)
    async with station(puppet) as scene:
        body = (await scene.do("service/param/export"))["body"]
        assert body == {"text": "A,1\nB,2\n", "count": 2}
        read = await scene.do("service/param/read", {"name": "_HASH_CHECK"})
        assert read["body"] == {"name": "_HASH_CHECK", "value": 0}
        given = {"text": "_HASH_CHECK,5\nA,2\n", "skip_unknown": False}
        assert (await scene.do("action/param/load", given))["body"]["skipped"] == ["_HASH_CHECK"]


async def test_what_is_not_in_the_new_list_is_forgotten() -> None:
    puppet = Puppet()
    puppet.params = {"A": (1.0, REAL), "B": (2.0, REAL), "C": (3.0, REAL)}
    async with station(puppet) as scene:
        parameters = scene.robot.parameters
        await parameters.list()
        assert parameters.known.keys() == {"A", "B", "C"}
        del puppet.params["B"]
        parameters.forget()
        assert "B" in parameters.known  # it may come again
        await parameters.list()
        assert parameters.known.keys() == {"A", "C"}
        with pytest.raises(UnknownPath):
            await parameters.write("B", 1.0)


async def test_a_refused_value_puts_all_back(pilot: Pilot, monkeypatch: Any) -> None:
    params = pilot.vehicle.params
    before = await exported(pilot)
    take = params.set

    def stubborn(name: str, value: float) -> bool:
        return take(name, params[name] if name == "RTL_ALT" else value)

    monkeypatch.setattr(params, "set", stubborn)
    text = "FENCE_RADIUS,50\nRTL_ALT,2000\nRTL_SPEED,100\n"
    reply = await pilot.do("action/param/load", {"text": text})
    assert reply["status"] == "failed"
    assert reply["error"]["code"] == "device_rejected"
    assert "the vehicle keeps RTL_ALT at 1500" in reply["message"]
    assert "every parameter has its value of before" in reply["message"]
    assert await exported(pilot) == before


async def test_a_cancelled_load_puts_all_back(pilot: Pilot, monkeypatch: Any) -> None:
    params, half = pilot.vehicle.params, asyncio.Event()
    before = await exported(pilot)
    take = params.set

    def noting(name: str, value: float) -> bool:
        half.set()
        return take(name, value)

    monkeypatch.setattr(params, "set", noting)
    text = "".join(f"TEST_{n},1000\n" for n in range(WHOLE))
    command = await pilot.client.send(
        type="execute", path="/tenant/t/action/param/load", body={"text": text}
    )
    accepted = await pilot.client.reply(command, 30.0)
    assert accepted["status"] == "accepted", accepted
    await half.wait()
    await pilot.client.request("cancel", command=accepted["command"])
    while (reply := await pilot.client.reply(command, 30.0))["status"] == "in_progress":
        pass
    assert reply["status"] == "cancelled", reply
    assert params["TEST_1299"] != 1000
    assert await exported(pilot) == before


async def test_nothing_is_loaded_or_reset_while_armed(pilot: Pilot) -> None:
    await pilot.do("action/arm")
    for name, body in (("load", {"text": "RTL_ALT,2000\n"}), ("reset", None)):
        reply = await pilot.do(f"action/param/{name}", body)
        assert reply["error"]["code"] == "precondition_failed", reply
    assert pilot.vehicle.params["RTL_ALT"] == 1500


async def test_a_reset_restores_the_defaults_and_is_seen(pilot: Pilot) -> None:
    before = await exported(pilot)
    await pilot.do("action/param/load", {"text": "RTL_ALT,2000\nTEST_3,9\n"})
    reply = await pilot.do("action/param/reset", None)
    assert reply["status"] == "completed", reply
    assert reply["body"]["text"] == before == await exported(pilot)
    assert pilot.vehicle.params["RTL_ALT"] == 1500

    async def seen() -> bool:
        return await pilot.read("param/RTL_ALT") == 1500

    await eventually(seen, "the default is published")


@pytest.mark.parametrize("text", ["", "\n# nothing\n"])
def test_a_file_without_parameters_is_no_file(text: str) -> None:
    assert parsed(text) == ([], [(1, "the file has no parameters")])


def test_a_file_has_an_end_and_so_has_what_is_told_of_it() -> None:
    text = "A,1\n" * 10_000
    assert parsed(text) == ([Entry(1, "A", 1.0)], [])
    assert parsed(text + "A,1") == ([], [(10_001, "a file may have at most 10000 lines")])
    _, faults = parsed(f"{'x' * 500} 1\nA {'y' * 500}\n")
    assert all(len(fault.reason) < 150 for fault in faults), faults


async def test_no_more_faults_are_told_than_anybody_reads() -> None:
    puppet = Puppet()
    puppet.params = {"A": (1.0, REAL)}
    async with station(puppet) as scene:
        text = "".join(f"B{n},1\n" for n in range(10_000))
        reply = await scene.do("action/param/load", {"text": text})
        assert len(reply["error"]["details"]["lines"]) == 100
        assert reply["message"].endswith("; and 9997 more")
        reply = await scene.do("action/param/load", {"text": text, "skip_unknown": True})
        assert len(reply["body"]["skipped"]) == 10_000


@pytest.mark.parametrize(
    "name",
    [
        "_HASH_CHECK", "FORMAT_VERSION", "SYSID_SW_MREV", "SYS_NUM_RESETS", "STAT_FLTTIME", "MIS_TOTAL", "FENCE_TOTAL",
        "RALLY_TOTAL", "CMD_INDEX", "LOG_LASTFILE", "GND_ABS_PRESS", "GND_TEMP", "BARO1_GND_PRESS", "BARO2_GND_PRESS",
    ],
)  # fmt: skip
def test_counters_and_measurements_are_states(name: str) -> None:
    assert is_state(name)
    for other in ("RTL_ALT", "MIS_RESTART", "BARO1_ALT_OFFSET", "LOG_BITMASK", "GND_EFFECT_COMP"):
        assert not is_state(other)


def test_values_are_written_with_the_digits_that_tell_them_apart() -> None:
    rows = [Row("A", 0.10000000149011612, REAL), Row("B", -1.0, INT8), Row("C", 1e-9, REAL)]
    text = FORMATS["param"](rows, 1, 1)
    assert text == "A,0.1\nB,-1\nC,1e-09\n"


def test_what_mission_planner_mavproxy_and_qgroundcontrol_write_is_read() -> None:
    entries, faults = parsed(
        "\ufeff#NOTE: of a tool\r\nA,1\r\nB   2.5  # why\r\n1\t1\tC\t-3.000000000000000000\t2\r\n\r\n"
    )
    assert faults == []
    assert entries == [Entry(2, "A", 1.0), Entry(3, "B", 2.5), Entry(4, "C", -3.0)]
    types = {"A": INT8, "B": REAL, "C": INT8}
    assert list(checked(entries, types)) == []


async def test_the_defaults_of_the_firmware_are_read_whatever_is_set() -> None:
    async with flying({"parameters": {"RTL_ALT": 2500}}, params=["RTL_*"]) as pilot:
        await pilot.ready()
        defaults = (await pilot.do("service/param/defaults"))["body"]["values"]
        usual = {name: default for name, (_, default) in table("copter").items()}
        assert defaults == pytest.approx(usual, rel=1e-6)
        assert (defaults["RTL_ALT"], pilot.vehicle.params["RTL_ALT"]) == (1500, 2500)


async def test_a_px4_has_them_in_its_metadata_alone() -> None:
    async with station(Puppet(autopilot=PX4)) as found:
        reply = await found.do("service/param/defaults")
        assert reply["error"]["code"] == "unknown_path"


def test_packed_defaults_are_read_past_padding_and_only_whole() -> None:
    data = b"\x1c\x67\x02\0\x02\0" + b"\x11\x20ABC\x05\x03" + b"\0\0" + b"\x04\x02D\0\0\x80?"
    assert unpacked(data) == {"ABC": 3, "ABD": 1.0}
    assert unpacked(b"\x1b\x67" + data[2:]) is None
    for wrong in (b"", b"\0\0" + data[2:], data[:-1], data[:6] + b"\x07" + data[7:]):
        with pytest.raises(ValueError, match=r"param\.pck"):
            unpacked(wrong)
