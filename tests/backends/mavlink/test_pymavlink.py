"""The tools that come with pymavlink fly the twin unchanged."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavftp, mavparm, mavutil, mavwp

from backends.mavlink.twins import twin_process

LAT, LON = -35.3632621, 149.1652374


@pytest.fixture
def master() -> Iterator[Any]:
    with twin_process("tcpin:127.0.0.1:0", options=("--speed", "10", "--warmup", "1")) as twin:
        link: Any = mavutil.mavlink_connection(
            f"tcp:127.0.0.1:{twin.ports['tcpin']}", source_system=255, dialect="ardupilotmega"
        )
        try:
            assert link.wait_heartbeat(timeout=60) is not None
            yield link
        finally:
            link.close()


def hear(master: Any, *types: str) -> Any:
    message = master.recv_match(type=list(types), blocking=True, timeout=60)
    assert message is not None, types
    return message


def test_mavwp_brings_a_mission_up_and_down_and_it_is_flown(master: Any, tmp_path: Path) -> None:
    ml = master.mav
    plan = mavwp.MAVWPLoader(1, 1)
    items = ((16, 0, LAT, LON, 0), (22, 3, 0, 0, 8), (16, 3, LAT + 1e-4, LON, 10), (20, 3, 0, 0, 0))
    for command, frame, lat, lon, height in items:
        plan.add(
            ml.mission_item_encode(1, 1, 0, frame, command, 0, 1, 0, 0, 0, 0, lat, lon, height)
        )
    master.waypoint_clear_all_send()
    assert hear(master, "MISSION_ACK").type == 0
    master.waypoint_count_send(plan.count())
    while (asked := hear(master, "MISSION_REQUEST", "MISSION_ACK")).get_type() != "MISSION_ACK":
        ml.send(plan.wp(asked.seq))
    assert asked.type == 0

    master.waypoint_request_list_send()
    back = mavwp.MAVWPLoader(1, 1)
    for number in range(hear(master, "MISSION_COUNT").count):
        master.waypoint_request_send(number)
        back.add(hear(master, "MISSION_ITEM"))
    back.save(str(tmp_path / "mission.txt"))
    assert mavwp.MAVWPLoader(1, 1).load(str(tmp_path / "mission.txt")) == 4
    assert [back.wp(n).command for n in range(4)] == [16, 22, 16, 20]

    values = mavparm.MAVParmDict()
    assert values.mavset(master, "RTL_LOIT_TIME", 0, retries=3)
    master.set_mode("GUIDED")
    for _ in range(300):
        if master.motors_armed():
            break
        master.arducopter_arm()
        hear(master, "HEARTBEAT")
    assert master.motors_armed(), master.messages.get("STATUSTEXT")
    master.set_mode_auto()
    master.motors_disarmed_wait()
    assert master.flightmode == "AUTO"


def test_mavftp_lists_puts_and_gets_the_parameters(master: Any, tmp_path: Path) -> None:
    ftp = mavftp.MAVFTP(master, target_system=1, target_component=1)
    assert ftp.cmd_list(["/"]).error_code == 0
    assert {"@PARAM", "APM"} <= {entry.name for entry in ftp.list_result}
    packed, text = tmp_path / "param.pck", tmp_path / "all.param"
    ftp.cmd_get(["@PARAM/param.pck?withdefaults=1", str(packed)])
    assert ftp.process_ftp_reply("OpenFileRO", timeout=30).error_code == 0
    decoded = mavftp.MAVFTP.ftp_param_decode(packed.read_bytes())
    assert decoded is not None
    assert len(decoded.params) > 600
    text.write_bytes(packed.read_bytes())
    ftp.cmd_put([str(text), "APM/scripts/all.param"])
    assert ftp.process_ftp_reply("CreateFile", timeout=30).error_code == 0
    ftp.cmd_list(["APM/scripts"])
    assert [(e.name, e.size_b) for e in ftp.list_result] == [("all.param", packed.stat().st_size)]
