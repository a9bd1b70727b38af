"""The variables by which ROS 2 chooses domain, discovery, middleware and security, checked without ROS.

rcl ignores a value that it does not know, or ends the process; both are worse than a sentence.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from rcp_ros2.config import Ros2Config

__all__ = ["lacking"]

_RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")
_DOMAINS = 232
_PROFILES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
_NEEDED = ("identity_ca.cert.pem", "cert.pem", "key.pem", "governance.p7s", "permissions.p7s")
"""What an enclave of SROS 2 has."""


def lacking(config: Ros2Config) -> str | None:
    """Return the first variable of ROS 2 with which the backend would not start, or hear nobody."""
    return next(_faults(config, os.environ), None)


def _faults(config: Ros2Config, environment: Mapping[str, str]) -> Iterator[str]:
    yield from (
        f"`interfaces`: there is no folder {folder}"
        for folder in config.interfaces
        if not Path(folder).is_dir()
    )
    domain = environment.get("ROS_DOMAIN_ID", "")
    if config.domain_id is None and domain and not _is_domain(domain):
        yield f"ROS_DOMAIN_ID is {domain!r}: set a number from 0 to {_DOMAINS}, or `domain_id`"
    range_ = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    if range_ and range_ not in _RANGES:
        yield f"ROS_AUTOMATIC_DISCOVERY_RANGE is {range_!r}: set one of {', '.join(_RANGES)}"
    if range_ == "OFF" and not environment.get("ROS_STATIC_PEERS"):
        yield (
            "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF and ROS_STATIC_PEERS is empty: the gateway would see "
            "no node; name the robot's address in ROS_STATIC_PEERS, or set LOCALHOST or SUBNET"
        )
    for name in _PROFILES:
        file = environment.get(name, "")
        if file and not Path(file).is_file():
            yield f"{name} names {file}, which is not there: correct or unset it"
    yield from _security(config, environment)


def _is_domain(text: str) -> bool:
    return text.isdecimal() and int(text) <= _DOMAINS


def _security(config: Ros2Config, environment: Mapping[str, str]) -> Iterator[str]:
    on = environment.get("ROS_SECURITY_ENABLE", "") == "true"
    enclave = config.enclave or environment.get("ROS_SECURITY_ENCLAVE_OVERRIDE", "")
    if config.enclave is not None and not on:
        yield (
            "`enclave` is set, but ROS_SECURITY_ENABLE is not 'true': the gateway would join "
            "without security; set it, and ROS_SECURITY_KEYSTORE"
        )
    if not on:
        return
    store = environment.get("ROS_SECURITY_KEYSTORE", "")
    if not store or not Path(store, "enclaves").is_dir():
        yield (
            f"ROS_SECURITY_KEYSTORE is {store!r}, which has no folder `enclaves`: name a keystore that "
            "was made with `ros2 security create_keystore`"
        )
        return
    folder = Path(store, "enclaves", *(enclave or "/").strip("/").split("/"))
    missing = [name for name in _NEEDED if not (folder / name).is_file()]
    if missing:
        yield (
            f"the enclave {enclave or '/'} in {folder} lacks {', '.join(missing)}: create it with "
            f"`ros2 security create_enclave {store} {enclave or '/'}`, or set `enclave`"
        )
