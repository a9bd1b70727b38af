"""Settings of drives: dumped, compared, loaded, stored and forgotten, and refused as a whole."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable
from typing import Any, NamedTuple

import anyio
import pytest

from backends.can.rig import Motor, motor
from backends.can.test_gateway import bed
from rcp_can.profiles.moteus_settings import MoteusSettings
from rcp_can.settings import read_text, same
from rcp_can.settings_procedures import settings_procedures
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceRejected,
    DeviceTimeout,
    InvalidValue,
    ModeForbids,
    OutOfRange,
)


class Make(NamedTuple):
    """One make: two settings, what they may be, and what its twin really has."""

    name: str
    good: str
    bad: str
    other: str
    own: str
    """A setting that is not written."""
    truth: Callable[[Any, str], float]
    keep: Callable[[Any, str], object]
    """Let the twin acknowledge a setting, and not change it."""
    saves: bool = True


def _damiao(name: str) -> int:
    from rcp_can.profiles.damiao_registers import NAMES

    return NAMES[name]


def _cybergear(name: str) -> int:
    from rcp_can.profiles.cybergear_settings import PARAMETERS

    return PARAMETERS[name].number


def _vesc(name: str) -> int:
    from rcp_can.profiles.vesc_settings import LIMITS

    return list(LIMITS).index(name)


def _float(data: bytes) -> float:
    return struct.unpack("<f", data)[0]


MAKES = {
    "damiao": Make(
        *("MAX_SPD", "20.5", "-1", "UV_Value", "ESC_ID"),
        lambda twin, name: _float(twin.registers[_damiao(name)]),
        lambda twin, name: twin.keeps.add(_damiao(name)),
    ),
    "cybergear": Make(
        *("limit_torque", "7.5", "-1", "limit_spd", "canTimeout"),
        lambda twin, name: _float(twin.parameters[_cybergear(name)]),
        lambda twin, name: twin.keeps.add(_cybergear(name)),
        saves=False,
    ),
    "vesc": Make(
        *("l_max_erpm", "20000", "-5", "l_in_current_max", "si_motor_poles"),
        lambda twin, name: twin.limits[_vesc(name)],
        lambda twin, name: twin.hardware_limits.update({_vesc(name): 5.0}),
    ),
    "moteus": Make(
        *("servo.max_current_A", "20.5", "-1", "servo.pid_position.kp", "can.prefix"),
        lambda twin, name: float(twin.console.settings[name]),
        lambda twin, name: twin.console.keeps.add(name),
    ),
}
EVERY = pytest.mark.parametrize("profile", MAKES)


def test_a_text_has_a_name_and_a_value_per_line() -> None:
    lines = read_text("# a comment\n\n a 1.5\nb\tnan\r\n")
    assert [(line.number, line.name, line.value) for line in lines] == [
        (3, "a", "1.5"),
        (4, "b", "nan"),
    ]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a 1\nb\n", "line 2: 'b' is not"),
        ("a 1 2", "line 1: 'a 1 2' is not"),
        ("a 1\nb 2\na 3", "line 3: 'a' is in line 1 too"),
        ("a 1\nb \uff11", "line 2: 'b .*has characters that no drive takes"),
        ("a 1\0", "line 1: .*has characters that no drive takes"),
        ("# nothing", "no settings"),
    ],
)
def test_a_text_that_is_none_is_refused_with_its_line(text: str, words: str) -> None:
    with pytest.raises(InvalidValue, match=words):
        read_text(text)


def test_values_are_the_same_as_far_as_drives_tell_them() -> None:
    assert same("0.1", str(_float(struct.pack("<f", 0.1))))
    assert same("nan", "NaN")
    assert not same("nan", "0")
    assert not same("1e-7", "2e-7")
    assert same("0.0000125", "0.000012", 6e-7)


@EVERY
async def test_settings_are_loaded_read_back_and_forgotten_unless_they_are_stored(
    profile: str,
) -> None:
    make = MAKES[profile]
    async with motor(profile, commissioning=True) as rig:
        dumped = await rig.ran("service/m/dump_settings")
        factory = {line.name: line.value for line in read_text(dumped["text"])}
        assert dumped["settings"] == len(factory)
        before = make.truth(rig.twin, make.name)
        assert same(factory[make.name], str(before))
        wanted = dumped["text"].replace(
            f"{make.name} {factory[make.name]}", f"{make.name} {make.good}"
        )
        compared = await rig.ran("service/m/compare_settings", {"text": wanted + "no.such 1\n"})
        assert [each["name"] for each in compared["differences"]] == [make.name]
        assert compared["unknown"] == ["no.such"]

        loaded = await rig.ran("action/m/load_settings", {"text": wanted})
        assert loaded == {
            "written": [make.name],
            "unchanged": len(factory) - 1,
            "left_out": [],
        }
        assert [feedback.name for feedback, _ in rig.feedback if feedback] == [make.name]
        assert make.truth(rig.twin, make.name) == float(make.good)

        await rig.ordered(rig.twin.boot)
        assert make.truth(rig.twin, make.name) == pytest.approx(before)
        if make.saves:
            await rig.ran("action/m/load_settings", {"text": f"{make.name} {make.good}"})
            await rig.ran("service/m/save_settings")
            await rig.ordered(rig.twin.boot)
            assert make.truth(rig.twin, make.name) == float(make.good)


@EVERY
async def test_a_text_with_a_wrong_line_is_refused_before_anything_is_written(
    profile: str,
) -> None:
    make = MAKES[profile]
    async with motor(profile, commissioning=True) as rig:
        before = make.truth(rig.twin, make.name)
        for line, error in ((f"{make.other} {make.bad}", OutOfRange), ("no.such 1", InvalidValue)):
            body = {"text": f"{make.name} {make.good}\n{line}\n"}
            if line.startswith(make.other) and profile == "moteus":
                continue  # the drive decides
            with pytest.raises(error, match="line 2") as caught:
                await rig.ran("action/m/load_settings", body)
            assert caught.value.details == {"pointer": "/text", "line": 2}
            if profile != "moteus" or error is OutOfRange:
                with pytest.raises(error, match="line 2"):
                    rig.backend.foresee(
                        "action/m/load_settings", rig.typed("action/m/load_settings", body)
                    )
        with pytest.raises(OutOfRange, match="line 1"):
            await rig.ran("action/m/load_settings", {"text": f"{make.name} {make.bad}"})
        assert make.truth(rig.twin, make.name) == before


@EVERY
async def test_settings_are_not_written_or_stored_while_the_motor_is_enabled(profile: str) -> None:
    make = MAKES[profile]
    async with motor(profile, commissioning=True) as rig:
        body = {"text": f"{make.name} {make.good}"}
        rig.backend.foresee("action/m/load_settings", rig.typed("action/m/load_settings", body))
        before = make.truth(rig.twin, make.name)
        await rig.enable()
        for name in ("action/m/load_settings", "service/m/save_settings", "service/m/set_node"):
            if name not in rig.host.resources:
                assert not make.saves
                continue
            plain = {"text": body["text"]} if "load" in name else {"node": 9}
            value = None if "save" in name else rig.typed(name, plain)
            with pytest.raises(ModeForbids, match="is enabled"):
                await rig.ran(name, None if value is None else plain)
            with pytest.raises(ModeForbids, match="is enabled"):
                rig.backend.foresee(name, value)
        assert make.truth(rig.twin, make.name) == before
        await rig.ran("service/m/dump_settings")  # only reads


@EVERY
async def test_settings_are_not_written_while_the_motor_is_being_enabled(profile: str) -> None:
    make = MAKES[profile]
    async with motor(profile, commissioning=True) as rig:
        await rig.until(lambda: rig.axis.configured and rig.axis.resting)
        before = make.truth(rig.twin, make.name)
        rig.twin.refuses = True
        enabling = asyncio.ensure_future(rig.enable())
        await rig.until(lambda: rig.axis.enabling)
        with pytest.raises(ModeForbids, match=r"is (being )?enabled"):
            await rig.ran("action/m/load_settings", {"text": f"{make.name} {make.good}"})
        assert make.truth(rig.twin, make.name) == before
        enabling.cancel()
        await asyncio.wait((enabling,), timeout=60)


@EVERY
async def test_a_value_that_the_drive_does_not_keep_is_an_error_that_tells_what_was_written(
    profile: str,
) -> None:
    make = MAKES[profile]
    async with motor(profile, commissioning=True) as rig:
        make.keep(rig.twin, make.name)
        text = f"{make.other} 21\n{make.name} {make.good}"
        with pytest.raises(DeviceRejected, match=f"line 2: the drive kept {make.name}") as caught:
            await rig.ran("action/m/load_settings", {"text": text})
        assert caught.value.details is not None
        assert caught.value.details["written"] == [make.other]
        assert "load what is left" in str(caught.value.remedy)
        assert make.truth(rig.twin, make.other) == 21


@EVERY
async def test_the_example_could_be_loaded(profile: str) -> None:
    async with motor(profile, commissioning=True) as rig:
        name = "action/m/load_settings"
        (example,) = rig.host.resources[name].examples
        await rig.ran(name, example)


@EVERY
async def test_what_the_gateway_sets_itself_is_left_out_and_named(profile: str) -> None:
    make = MAKES[profile]
    async with motor(profile, commissioning=True) as rig:
        text = f"{make.own} 99\n{make.name} {make.good}"
        loaded = await rig.ran("action/m/load_settings", {"text": text})
        assert (loaded["written"], loaded["left_out"]) == ([make.name], [make.own])


@EVERY
async def test_a_bus_that_is_cut_between_two_settings_is_no_refusal(profile: str) -> None:
    make = MAKES[profile]
    async with motor(profile, commissioning=True) as rig:
        text = f"{make.name} {make.good}\n{make.other} 21"
        seen = asyncio.Event()

        def cut(feedback: Any = None, *, fraction: float | None = None) -> None:
            if feedback is not None:
                rig.twin.silent = True
                seen.set()

        value = rig.typed("action/m/load_settings", {"text": text})
        with anyio.fail_after(60):
            with pytest.raises((DeviceTimeout, AdapterUnavailable)) as caught:
                await rig.backend.execute("action/m/load_settings", value, cut)
        assert seen.is_set()
        assert caught.value.status == "failed"
        assert caught.value.details is not None
        assert caught.value.details["written"] == [make.name]
        await rig.host.until(lambda: not rig.axis.online)
        rig.twin.silent = False
        await _retried(rig, text)
        assert make.truth(rig.twin, make.other) == 21


@EVERY
async def test_a_drive_that_reboots_between_two_settings_is_no_success(profile: str) -> None:
    make = MAKES[profile]
    async with motor(profile, commissioning=True) as rig:
        before = make.truth(rig.twin, make.name)

        def boot(feedback: Any = None, *, fraction: float | None = None) -> None:
            if feedback is not None and feedback.name == make.name:
                rig.twin.boot()

        text = f"{make.name} {make.good}\n{make.other} 21"
        value = rig.typed("action/m/load_settings", {"text": text})
        with anyio.fail_after(60):
            with pytest.raises((DeviceRejected, DeviceTimeout)) as caught:
                await rig.backend.execute("action/m/load_settings", value, boot)
        assert caught.value.details is not None
        assert make.name not in caught.value.details["written"]
        assert make.truth(rig.twin, make.name) == pytest.approx(before)


async def _retried(rig: Motor, text: str) -> None:
    axis = rig.axis
    await rig.until(lambda: axis.online and axis.configured and axis.blind is None)
    if rig.axis.status.faults:
        await rig.ran("service/m/clear_faults")
    await rig.ran("action/m/load_settings", {"text": text})


async def test_a_lost_part_of_a_long_answer_is_an_error_and_not_a_shorter_answer() -> None:
    async with motor("moteus", commissioning=True) as rig:
        whole = await rig.ran("service/m/dump_settings")
        said: list[int] = []
        real = rig.twin.console.say

        def say(most: int) -> bytes:
            part = real(most)
            said.append(len(part))
            rig.twin.deaf = len(said) == 5  # what was said is lost, and so is the next poll
            return part

        rig.twin.console.say = say
        loses = rig.twin.send
        rig.twin.send = lambda *args, **more: None if rig.twin.deaf else loses(*args, **more)
        with pytest.raises(DeviceTimeout, match="a part of its answer did not arrive"):
            await rig.ran("service/m/dump_settings")
        rig.twin.deaf = False
        await rig.until(lambda: rig.axis.online and rig.axis.configured)
        assert await rig.ran("service/m/dump_settings") == whole


async def test_a_moteus_that_does_not_stop_talking_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcp_can.profiles.moteus_stream._NOISE", 5)
    async with motor("moteus", commissioning=True) as rig:
        rig.twin.console.say = lambda _most: b"emit servo_stats\r\n"
        with pytest.raises(DeviceRejected, match="does not stop telling"):
            await rig.ran("service/m/dump_settings")


async def test_a_moteus_that_starts_to_talk_after_a_command_is_told_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rcp_can.profiles.moteus_stream._LONGEST", 500)
    async with motor("moteus", commissioning=True) as rig:
        console = rig.twin.console
        real = console.hear

        def hear(data: bytes) -> None:
            real(data)
            console.say = lambda _most: b"emit servo_stats\r\n"

        console.hear = hear
        with pytest.raises(DeviceRejected, match="does not stop telling"):
            await rig.ran("service/m/dump_settings")


@EVERY
async def test_settings_are_not_written_or_stored_while_the_motor_coasts(profile: str) -> None:
    make = MAKES[profile]
    async with motor(profile, commissioning=True) as rig:
        await rig.until(lambda: rig.axis.configured and rig.axis.resting)
        before = make.truth(rig.twin, make.name)
        rig.twin.plant.load = 0.05  # something turns the shaft
        await rig.until(lambda: not rig.axis.resting)
        for name, body in (
            ("action/m/load_settings", {"text": f"{make.name} {make.good}"}),
            ("service/m/save_settings", None),
            ("service/m/set_node", {"node": 9}),
        ):
            if name in rig.host.resources:
                with pytest.raises(ModeForbids, match="is moving"):
                    await rig.ran(name, body)
        await rig.ran("service/m/dump_settings")
        assert make.truth(rig.twin, make.name) == before
        assert rig.twin.node != 9


async def test_a_bus_that_is_lost_after_the_command_to_store_is_no_refusal() -> None:
    class Lost(MoteusSettings):
        def __init__(self) -> None:
            """Have no drive."""

        async def save(self) -> None:
            raise AdapterUnavailable("CAN bus 'can0' is down: unplugged")

    (save,) = (each for each in settings_procedures(Lost()) if each.verb == "save_settings")
    with pytest.raises(AdapterUnavailable) as caught:
        await save.run(None, lambda *_args, **_more: None)
    assert caught.value.status == "failed"


async def test_a_command_to_a_moteus_that_needs_two_frames_is_queued_whole_or_not_at_all() -> None:
    name = "aux1.a_setting_with_a_name_that_is_so_long_that_it_needs_two_frames"
    async with motor("moteus", commissioning=True) as rig:
        await rig.until(lambda: rig.axis.configured)
        rig.twin.console.settings[name] = "1.000000"
        wire = rig.backend.buses["can0"].wire
        real, queued = wire.send_together, list[list[bytes]]()

        def send_together(messages: Any, **more: Any) -> None:
            queued.append([bytes(each.data) for each in messages])
            real(messages, **more)

        wire.send_together = send_together
        await rig.ran("action/m/load_settings", {"text": f"{name} 0.5"})
        (command,) = (each for each in queued if b"conf set" in each[0])
        assert len(command) == 2
        assert rig.twin.console.settings[name] == "0.500000"


async def test_through_a_gateway_an_e_stop_ends_the_loading_and_stores_nothing() -> None:
    async with bed("moteus", commissioning=True) as held:
        console = held.twin.console
        offsets = [f"motor.offset.{place}" for place in range(64)]
        body = {"text": "".join(f"{name} 0.5\n" for name in offsets)}
        dry = await held.ask("execute", "action/m/load_settings", body, dry_run=True)
        assert (dry["status"], dry["dry_run"]) == ("completed", True), dry
        assert console.settings[offsets[0]] == "0.000000"
        path = "/tenant/t/action/m/load_settings"
        id_ = await held.client.send(type="execute", path=path, body=body)
        await held.until(lambda: console.settings[offsets[3]] != "0.000000")
        stopped = await held.client.request("execute", "/system/estop", body={}, within=60.0)
        assert stopped["status"] == "completed", stopped
        reply = await held.client.final(id_, 20.0)
        assert reply["status"] in ("failed", "cancelled"), reply
        assert console.settings[offsets[63]] == "0.000000"
        assert console.writes == 0
        again = await held.code("execute", "action/m/load_settings", body)
        assert again == "estop_active"
        await held.done("service/m/dump_settings")  # a look is allowed
