"""What the robot is: its kind from the configuration, the rest from its drives."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_can.config import CanConfig
from rcp_can.drive import Identity
from rcp_kernel.spi import Host, RobotFacts

__all__ = ["Facts"]


class Facts:
    """Describes the robot to the kernel, again whenever a drive has told what it is."""

    def __init__(self, config: CanConfig, host: Host) -> None:
        self._host = host
        self._kind = _kind(config)
        self._drives: dict[str, Identity | None] = dict.fromkeys(config.motors)
        self._describe()

    def report(self, motor: str, identity: Identity | None) -> None:
        """Note what a motor's drive is, once it is configured."""
        if identity != self._drives[motor]:
            self._drives[motor] = identity
            self._describe()

    def _describe(self) -> None:
        drives = [drive or Identity() for drive in self._drives.values()]
        self._host.describe(
            RobotFacts(
                kind=self._kind,
                vendor=_common(drive.vendor for drive in drives),
                model=_common(drive.model for drive in drives),
                firmware=_common(drive.firmware for drive in drives),
                serial=_common(drive.serial for drive in drives),
            )
        )


def _common(values: Iterable[str | None]) -> str | None:
    """Return what all drives say; of different ones none stands for the robot."""
    found = set(values)
    return found.pop() if len(found) == 1 else None


def _kind(config: CanConfig) -> str | None:
    if config.diff_drives:
        return "mobile_manipulator" if config.joint_groups else "differential_drive"
    if config.joint_groups:
        return "arm"
    return "motor" if config.motors else None
