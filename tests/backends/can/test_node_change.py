"""Another id for a drive: stored, read back under it, and refused before writing if it is taken."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable
from typing import Any

import can
import pytest

from backends.can.rig import channel, motor, opened
from rcp_can.node_change import NodeChange, node_procedure
from rcp_can.sim import Bench, make_twin
from rcp_kernel.errors import (
    AdapterUnavailable,
    ConfigError,
    DeviceRejected,
    DeviceTimeout,
    ModeForbids,
    OutOfRange,
)

EVERY = pytest.mark.parametrize("profile", ["damiao", "cybergear", "vesc", "moteus"])


@EVERY
async def test_a_drive_answers_to_its_new_id_after_a_reboot_too(profile: str) -> None:
    async with motor(profile, commissioning=True) as rig:
        rig.backend.foresee("service/m/set_node", rig.typed("service/m/set_node", {"node": 9}))
        assert rig.twin.node != 9  # a dry run writes nothing
        assert await rig.ran("service/m/set_node", {"node": 9}) == {"node": 9}
        assert rig.twin.node == 9
        await rig.ordered(rig.twin.boot)
        assert rig.twin.node == 9
        await rig.host.until(lambda: not rig.axis.online)  # nothing answers to the old one


@EVERY
async def test_an_id_that_another_drive_answers_to_is_refused_before_anything_is_written(
    profile: str,
) -> None:
    options = {"reply_id": 0x31} if profile == "damiao" else {}
    other = make_twin(profile, 9, **options)
    async with motor(profile, commissioning=True, twins=(other,)) as rig:
        before = rig.twin.node
        with pytest.raises(ModeForbids, match="9 is taken: a drive on this bus answers") as caught:
            await rig.ran("service/m/set_node", {"node": 9})
        assert "Nothing was written" in str(caught.value.remedy)
        assert (rig.twin.node, other.node) == (before, 9)
        assert getattr(rig.twin, "stores", 0) == 0


@EVERY
async def test_the_id_of_another_motor_of_the_configuration_is_refused_though_it_is_off(
    profile: str,
) -> None:
    second = {"bus": "can0", "profile": profile, "node": 11, "optional": True}
    table = {"bus": "can0", "profile": profile, "node": 2, "commissioning": True}
    bus = {"interface": "virtual", "channel": channel(), "fd": profile == "moteus"}
    config = {"buses": {"can0": bus}, "motors": {"m": table, "second": second}, "grace": 0.01}
    line = can.Bus(
        bus["channel"],
        "virtual",
        protocol=can.CanProtocol.CAN_FD if bus["fd"] else can.CanProtocol.CAN_20,
        ignore_config=True,
    )
    with Bench(line, [make_twin(profile, 2)]):
        async with opened(config) as rig:
            await rig.host.until(lambda: rig.backend.axes["m"].configured)
            value = rig.typed("service/m/set_node", {"node": 11})
            with pytest.raises(ModeForbids, match="that of motor 'second'"):
                rig.backend.foresee("service/m/set_node", value)


@EVERY
async def test_an_id_that_no_such_drive_can_have_is_out_of_range(profile: str) -> None:
    async with motor(profile, commissioning=True) as rig:
        with pytest.raises(OutOfRange, match="not 300"):
            await rig.ran("service/m/set_node", {"node": 300})


@EVERY
async def test_a_drive_that_is_cut_off_meanwhile_is_no_success(profile: str) -> None:
    async with motor(profile, commissioning=True) as rig:
        rig.twin.deaf = True
        with pytest.raises(DeviceTimeout):
            await rig.ran("service/m/set_node", {"node": 9})
        assert rig.twin.node != 9


@pytest.mark.parametrize("written", [False, True])
async def test_an_error_once_the_id_may_be_written_is_no_refusal_and_says_where_it_may_be(
    *, written: bool
) -> None:
    async def change(_wanted: NodeChange, begun: Callable[[], object]) -> None:
        if written:
            begun()
        raise AdapterUnavailable("CAN bus 'can0' is down: unplugged")

    async def is_there(_node: int) -> bool:
        return False

    procedure = node_procedure(2, range(1, 16), {}, change, is_there)
    with pytest.raises(AdapterUnavailable) as caught:
        await procedure.run(NodeChange(node=9), lambda *_args, **_more: None)
    assert caught.value.status == ("failed" if written else "rejected")
    assert ("set `node` to 9" in str(caught.value.remedy)) is written


# Damiao


async def test_a_damiao_may_get_another_id_of_its_responses_too() -> None:
    async with motor("damiao", commissioning=True) as rig:
        await rig.ran("service/m/set_node", {"node": 5, "reply_id": 0x15})
        await rig.ordered(rig.twin.boot)
        assert (rig.twin.node, rig.twin.reply_id) == (5, 0x15)


async def test_a_damiao_with_other_full_scales_than_configured_is_not_enabled() -> None:
    async with motor("damiao", commissioning=True) as rig:
        await rig.ran("action/m/load_settings", {"text": "VMAX 45"})
        with pytest.raises(
            DeviceRejected, match="VMAX of the drive is 45, and of this motor 30"
        ) as e:
            await rig.enable()
        assert "ranges = [12.5, 45, 10]" in str(e.value.remedy)
        assert not rig.twin.enabled
        await rig.ran("action/m/load_settings", {"text": "VMAX 30"})
        await rig.enable()
        assert rig.twin.enabled


async def test_a_damiao_that_rebooted_unnoticed_has_its_watchdog_before_it_is_enabled() -> None:
    async with motor("damiao") as rig:
        await rig.until(lambda: rig.axis.configured)
        await rig.ordered(rig.twin.boot)
        assert rig.twin.registers[9] == bytes(4)
        await rig.enable()
        assert rig.twin.registers[9] == struct.pack("<I", 10_000)


@pytest.mark.parametrize("reply_id", [5, 0x7FF, 0x103, 40])
async def test_a_damiao_does_not_respond_by_an_identifier_that_commands_a_drive(
    reply_id: int,
) -> None:
    neighbour = {"bus": "can0", "profile": "mit", "node": 40, "optional": True}
    async with motor(
        "damiao", commissioning=True, config={"grace": 0.01}, motors={"n": neighbour}
    ) as rig:
        await rig.until(lambda: rig.axis.configured)
        value = rig.typed("service/m/set_node", {"node": 3, "reply_id": reply_id})
        with pytest.raises(OutOfRange, match="an identifier by which drives are commanded"):
            rig.backend.foresee("service/m/set_node", value)
        assert rig.twin.stores == 0


async def test_a_damiao_does_not_get_the_id_of_another_drive_that_takes_its_set_points() -> None:
    neighbour = {"bus": "can0", "profile": "tmotor", "node": 9, "optional": True}
    async with motor(
        "damiao", commissioning=True, config={"grace": 0.01}, motors={"n": neighbour}
    ) as rig:
        await rig.until(lambda: rig.axis.configured)
        with pytest.raises(ModeForbids, match="that of motor 'n'"):
            await rig.ran("service/m/set_node", {"node": 9})
        assert rig.twin.node == 3


async def test_motors_that_take_the_same_set_points_need_two_ids_though_their_profiles_differ() -> (
    None
):
    motors = {
        "a": {"bus": "can0", "profile": "mit", "node": 3},
        "b": {"bus": "can0", "profile": "damiao", "node": 3},
    }
    bus = {"interface": "virtual", "channel": channel()}
    with pytest.raises(ConfigError, match="3 is already used by"):
        async with opened({"buses": {"can0": bus}, "motors": motors}):
            pass


async def test_a_damiao_that_forgot_its_full_scales_unnoticed_is_not_enabled() -> None:
    async with motor("damiao", commissioning=True) as rig:
        await rig.ran("action/m/load_settings", {"text": "VMAX 45"})
        await rig.ran("service/m/save_settings")
        await rig.ran("action/m/load_settings", {"text": "VMAX 30"})
        await rig.ordered(rig.twin.boot)
        with pytest.raises(DeviceRejected, match="VMAX of the drive is 45"):
            await rig.enable()
        assert not rig.twin.enabled


# CyberGear


async def test_a_cybergear_that_does_not_tell_who_it_is_keeps_its_id() -> None:
    async with motor("cybergear", commissioning=True) as rig:
        await rig.until(lambda: rig.axis.configured)
        rig.twin.anonymous = True
        with pytest.raises(DeviceTimeout, match="the number of its processor") as caught:
            await rig.ran("service/m/set_node", {"node": 9})
        assert "Nothing was written" in str(caught.value.remedy)
        assert rig.twin.node == 4


# VESC


def test_the_commands_of_a_vesc_are_those_of_its_firmware() -> None:
    from rcp_can.profiles import vesc_settings as ours

    assert (ours.VERSION, ours.SET_APP, ours.GET_APP) == (0, 16, 17)
    assert (ours.SET_LIMITS, ours.GET_LIMITS) == (48, 91)  # 93 is that of custom configurations


async def test_two_vescs_are_asked_one_after_the_other() -> None:
    second = make_twin("vesc", 8)
    table = {"bus": "can0", "profile": "vesc", "node": 8, "commissioning": True}
    async with motor("vesc", commissioning=True, twins=(second,), motors={"n": table}) as rig:
        axes = rig.backend.axes
        await rig.until(lambda: axes["m"].configured and axes["n"].configured)
        rig.twin.deaf = True
        silent = asyncio.ensure_future(rig.backend.execute("service/m/dump_settings", None, print))
        await asyncio.sleep(0)
        await rig.ran("service/n/dump_settings")
        assert silent.done()  # it had its time first
        with pytest.raises(DeviceTimeout):
            await silent


@pytest.mark.parametrize("firmware", [(3, 65), (7, 0)])
async def test_the_limits_of_a_vesc_with_unknown_firmware_are_not_touched(
    firmware: tuple[int, int],
) -> None:
    async with motor("vesc", commissioning=True) as rig:
        rig.twin.firmware = firmware
        for name, body in (
            ("service/m/dump_settings", None),
            ("action/m/load_settings", {"text": "l_max_erpm 1000"}),
            ("service/m/save_settings", None),
        ):
            with pytest.raises(DeviceRejected, match=r"known are 5\.x and 6\.x"):
                await rig.ran(name, body)
        assert (rig.twin.limits[3], rig.twin.stores) == (1e5, 0)


async def test_a_configuration_of_a_vesc_with_an_unknown_layout_is_not_written() -> None:
    async with motor("vesc", commissioning=True) as rig:
        rig.twin.signature = 1
        with pytest.raises(DeviceRejected, match="layout 1, which is not known"):
            await rig.ran("service/m/set_node", {"node": 9})
        assert (rig.twin.node, rig.twin.stores) == (7, 0)


async def test_the_rest_of_a_vescs_configuration_stays_as_it_was() -> None:
    async with motor("vesc", commissioning=True) as rig:
        before = rig.twin.rest
        await rig.ran("service/m/set_node", {"node": 9})
        assert rig.twin.rest == before


async def test_a_vesc_has_not_the_id_of_the_gateway() -> None:
    async with motor("vesc", commissioning=True) as rig:
        with pytest.raises(ModeForbids, match="254 is taken"):
            await rig.ran("service/m/set_node", {"node": 254})


# Identity


@pytest.mark.parametrize(
    ("profile", "facts"),
    [
        ("damiao", {"vendor": "Damiao", "firmware": "5013.2"}),
        ("cybergear", {"vendor": "Xiaomi", "model": "CyberGear", "serial": "4359424700000004"}),
        ("vesc", {"vendor": "VESC", "model": "410", "firmware": "6.00"}),
        ("moteus", {"vendor": "mjbots", "model": "moteus 204", "firmware": "0x010a"}),
    ],
)
async def test_drives_tell_what_they_are(profile: str, facts: dict[str, Any]) -> None:
    async with motor(profile, commissioning=True) as rig:
        await rig.until(lambda: rig.axis.configured)
        for name, value in facts.items():
            assert await rig.backend.read(f"param/m/{name}") == value
