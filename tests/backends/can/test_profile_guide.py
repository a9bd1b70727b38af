"""The profile of the guide does what it says: it runs as it stands there, under the tests of the motor model."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from backends.can import test_motors as model
from backends.can.rig import MOTORS, channel, motor, opened
from rcp_can.config_motor import BUILTIN_PROFILES, MotorConfig
from rcp_can.profiles import PROFILES
from rcp_can.sim.__main__ import main
from rcp_kernel.errors import ConfigError

PAGE = Path(__file__).parents[3] / "docs" / "add-a-motor-profile.md"
NAME = "my_servo:PROFILE"


def blocks(language: str) -> list[str]:
    text = PAGE.read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


@pytest.fixture(autouse=True)
def servo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    (tmp_path / "my_servo.py").write_text("\n".join(blocks("python")))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setitem(MOTORS, NAME, {"node": 3})
    yield
    sys.modules.pop("my_servo", None)


@pytest.mark.parametrize(
    "holds",
    [
        model.test_it_is_heard_of_at_once_and_is_switched_off,
        model.test_enabling_is_never_implied,
        model.test_it_is_enabled_at_rest_and_disabled_again,
        model.test_a_velocity_is_that_of_the_joint_behind_the_gear,
        model.test_a_move_completes_where_it_was_to_go,
        model.test_a_position_is_kept_to,
        model.test_a_ramp_lets_no_velocity_jump,
        model.test_a_halt_is_a_quick_stop_and_nothing_moves_after_it,
        model.test_a_cancelled_move_has_come_to_rest_before_it_ends,
        model.test_a_goal_beyond_the_limits_is_out_of_range,
        model.test_a_drive_that_will_not_switch_on_is_told,
        model.test_silence_is_a_fault_that_ends_the_move_and_nothing_moves_when_it_is_over,
    ],
    ids=lambda test: test.__name__.removeprefix("test_"),
)
async def test_of_the_servo_of_the_guide(holds: Any) -> None:
    await holds(NAME)


async def test_its_fault_is_told_and_cleared_without_moving() -> None:
    async with motor(NAME) as rig:
        await rig.enable()
        await rig.ordered(rig.twin.break_down)
        state = await rig.host.published_as("sensor/m/state", state="fault")
        assert state.faults == ["over_temperature"]
        await rig.ran("service/m/clear_faults")
        await rig.host.published_as("sensor/m/state", state="disabled", faults=[])


async def test_the_configuration_of_the_guide_runs_its_twin() -> None:
    (text,) = blocks("toml")
    table = tomllib.loads(text)["backends"][0]
    for key in ("use", "tenant"):
        del table[key]
    table["buses"]["can0"]["channel"] = channel()
    async with opened({**table, "grace": 5.0}) as rig:
        await rig.ran("service/jaw/enable")
        moved = await rig.ran("action/jaw/move_to", {"position": 0.6})
        assert moved["position"] == pytest.approx(0.6, abs=0.02)


def test_its_twin_runs_by_itself(capsys: pytest.CaptureFixture[str]) -> None:
    main([f"{NAME}:3", "--interface", "virtual", "--channel", channel(), "--seconds", "0.05"])
    assert capsys.readouterr().out.startswith("1 drives on")


@pytest.mark.parametrize(
    ("profile", "words"),
    [
        ("nowhere_at_all:PROFILE", "No module named"),
        ("my_servo:NOTHING", "NOTHING"),
        ("my_servo:COMMAND", "is not a profile but a Layout"),
    ],
)
async def test_a_profile_that_there_is_not_is_a_configuration_error(
    profile: str, words: str
) -> None:
    bus = {"interface": "virtual", "channel": channel()}
    table = {"bus": "can0", "profile": profile, "node": 3}
    with pytest.raises(ConfigError, match=rf"motors\.m\.profile: .*{words}"):
        async with opened({"buses": {"can0": bus}, "motors": {"m": table}}):
            pass


def test_a_word_that_is_no_profile_is_told_those_there_are() -> None:
    assert tuple(PROFILES) == BUILTIN_PROFILES
    with pytest.raises(msgspec.ValidationError, match="cia402, odrive"):
        msgspec.convert({"bus": "can0", "profile": "steam", "node": 1}, MotorConfig)
