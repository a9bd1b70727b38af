"""Another id for a drive: stored, read back under it, and refused before writing if it is taken."""

from __future__ import annotations

import struct
from typing import Any

import can
import pytest

from backends.can.rig import channel, motor, opened
from rcp_can.sim import Bench, make_twin
from rcp_kernel.errors import (
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


# VESC


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
