"""The robots that come with the package."""

from __future__ import annotations

from pathlib import Path

import msgspec

from rcp_mujoco.config import ArmConfig, GripperConfig, MujocoConfig, WheelsConfig

__all__ = ["MODELS", "complete", "model_path"]

MODELS = Path(__file__).parent / "models"
_JOINTS = tuple(f"joint_{number}" for number in range(1, 7))
_PARTS = {
    "rover": {
        "wheels": WheelsConfig(
            left=("left_wheel",), right=("right_wheel",), radius=0.08, track=0.36
        ),
    },
    "arm": {
        "arm": ArmConfig(joints=_JOINTS, tool="tool"),
        "gripper": GripperConfig(
            actuator="gripper", open=0.04, closed=0.0, contacts=("left_pad", "right_pad")
        ),
    },
}


def model_path(config: MujocoConfig) -> Path:
    """Return the file of the configured model."""
    if config.model in _PARTS:
        return MODELS / f"{config.model}.xml"
    return Path(config.model).expanduser()


def complete(config: MujocoConfig) -> MujocoConfig:
    """Fill in the parts of an included robot."""
    parts = _PARTS.get(config.model, {})
    given = {name: part for name, part in parts.items() if getattr(config, name) is None}
    return msgspec.structs.replace(config, **given)
