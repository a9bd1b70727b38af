"""The README tells every key of the configuration, every profile's options, and every fault by name."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import rcp_can
from rcp_can.config import BusConfig, CanConfig
from rcp_can.config_device import DeviceConfig
from rcp_can.config_diff_drive import DiffDriveConfig
from rcp_can.config_dronecan import DronecanConfig
from rcp_can.config_joints import JointGroupConfig
from rcp_can.config_motor import BUILTIN_PROFILES, MotorConfig
from rcp_can.config_node import NodeConfig
from rcp_can.profiles import profile

FOLDER = Path(rcp_can.__file__).parent
README = (FOLDER / "README.md").read_text(encoding="utf-8")
TABLES = (CanConfig, BusConfig, MotorConfig, DeviceConfig, NodeConfig)
TABLES += (
    DronecanConfig,
    DiffDriveConfig,
    JointGroupConfig,
    *(profile(name).options for name in BUILTIN_PROFILES),
)


@pytest.mark.parametrize("table", dict.fromkeys(TABLES), ids=lambda table: table.__name__)
def test_every_key_is_told(table: Any) -> None:
    assert [key for key in table.__struct_fields__ if f"`{key}`" not in README] == []


def test_every_profile_is_told() -> None:
    for name in BUILTIN_PROFILES:
        assert f"| `{name}` |" in README


def test_every_fault_of_the_gateway_is_told() -> None:
    source = "".join(path.read_text(encoding="utf-8") for path in FOLDER.glob("*.py"))
    found = re.findall(r'(?:self\.fault|Loss)\(\s*"(\w+)"', source)
    assert len(found) > 5
    assert [name for name in found if f"`{name}`" not in README] == []
