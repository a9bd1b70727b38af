"""What `rcpd check` says of the variables of ROS 2: it opens nothing, and needs no rclpy."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from configuration import backend, listener
from rcp_ros2 import Ros2Config
from rcp_ros2.environment import lacking

FILES = ("identity_ca.cert.pem", "cert.pem", "key.pem", "governance.p7s", "permissions.p7s")


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("ROS_DOMAIN_ID", "233", "a number from 0 to 232"),
        ("ROS_DOMAIN_ID", "blue", "a number from 0 to 232"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost", "SUBNET, LOCALHOST, OFF, SYSTEM_DEFAULT"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF", "ROS_STATIC_PEERS"),
        ("FASTDDS_DEFAULT_PROFILES_FILE", "/nowhere/dds.xml", "correct or unset it"),
        ("ROS_SECURITY_ENABLE", "true", "create_keystore"),
    ],
)
def test_a_variable_that_would_isolate_the_gateway_is_told(
    name: str, value: str, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROS_STATIC_PEERS", raising=False)
    monkeypatch.setenv(name, value)
    assert told in (lacking(Ros2Config()) or "")


def test_a_domain_of_the_configuration_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "blue")
    assert lacking(Ros2Config(domain_id=3)) is None


def test_an_enclave_needs_security_and_its_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = Ros2Config(enclave="/robots/gateway")
    assert "ROS_SECURITY_ENABLE is not 'true'" in (lacking(config) or "")
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(tmp_path))
    folder = tmp_path / "enclaves" / "robots" / "gateway"
    folder.mkdir(parents=True)
    for name in FILES[1:]:
        (folder / name).touch()
    assert re.search(rf"lacks {FILES[0]}.*create_enclave", lacking(config) or "")
    (folder / FILES[0]).touch()
    assert lacking(config) is None


def test_check_tells_of_it_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "rcp.toml"
    file.write_text(listener() + backend("robot", use="ros2"))
    rcpd = Path(sys.executable).with_name("rcpd")
    environment = os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "NEARBY"}
    done = subprocess.run(
        [rcpd, "check", file], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE is 'NEARBY'" in done.stderr
