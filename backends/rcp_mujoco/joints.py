"""Joints and actuators of a model, with their units and bounds."""

from __future__ import annotations

import itertools
import re
from typing import Any, Literal, NamedTuple

import numpy as np

from rcp_mujoco.bindings import mujoco

__all__ = ["Drive", "Joint", "distinct", "drives", "joints", "plain", "robot_dofs"]

_UNLIMITED = 1e6
_JOINT = int(mujoco.mjtTrn.mjTRN_JOINT)  # arrays hold plain numbers, which no enum is equal to
_SLIDE, _HINGE = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
_FIXED, _INTEGRATOR = int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
_UNBIASED, _AFFINE = int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)

Mode = Literal["position", "velocity", "torque", "other"]


class Joint(NamedTuple):
    """A hinge or slide joint."""

    name: str
    unit: Literal["rad", "m"]
    low: float
    high: float
    qpos: int
    dof: int


class Drive(NamedTuple):
    """An actuator."""

    name: str
    number: int
    mode: Mode
    unit: str
    low: float
    high: float
    joint: Joint | None
    dofs: tuple[int, ...]
    """The degrees of freedom that it moves."""
    ratio: float = 1.0
    """Control per position, velocity or force of the joint, by the gear and the gain."""
    offset: float = 0.0

    def control(self, value: float) -> float:
        """Return the control for a position, velocity or force of the joint, within its bounds."""
        return min(self.high, max(self.low, self.ratio * value + self.offset))

    @property
    def safe(self) -> float | None:
        """The value without motion; None if that is the current position."""
        return None if self.mode in ("position", "other") else 0.0


_UNITS = {
    "position": {"rad": "rad", "m": "m"},
    "velocity": {"rad": "rad/s", "m": "m/s"},
    "torque": {"rad": "N.m", "m": "N"},
}


def plain(name: str) -> str:
    """Return a name of the model as a segment of a path."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", name)


def distinct(name: str, taken: set[str]) -> str:
    """Return a name that is not taken yet, with a number where necessary; take it."""
    found = name
    for number in itertools.count(2):
        if found not in taken:
            break
        found = f"{name}_{number}"
    taken.add(found)
    return found


def joints(model: Any) -> list[Joint]:
    """List the hinges and slides, in the order of the model."""
    found: list[Joint] = []
    taken: set[str] = set()
    for index in range(model.njnt):
        kind = int(model.jnt_type[index])
        if kind not in (_SLIDE, _HINGE):
            continue
        low, high = model.jnt_range[index] if model.jnt_limited[index] else (-np.inf, np.inf)
        unit: Literal["rad", "m"] = "m" if kind == _SLIDE else "rad"
        name = plain(model.joint(index).name).replace(".", "_")  # bounds are by dotted places
        name = distinct(name or f"joint_{index}", taken)
        qpos, dof = int(model.jnt_qposadr[index]), int(model.jnt_dofadr[index])
        found.append(Joint(name, unit, float(low), float(high), qpos, dof))
    return found


def drives(model: Any) -> list[Drive]:
    """List the actuators, in the order of the model."""
    by_dof = {joint.dof: joint for joint in joints(model)}
    moments = _moments(model)
    found: list[Drive] = []
    taken: set[str] = set()
    for index in range(model.nu):
        mode = _mode(model, index)
        joint = None
        if model.actuator_trntype[index] == _JOINT:
            joint = by_dof.get(int(model.jnt_dofadr[model.actuator_trnid[index][0]]))
        ratio, offset = _ratio(model, index, mode) if joint is not None else (1.0, 0.0)
        unit = "1"
        if joint is not None and mode != "other" and abs(ratio) == 1.0 and not offset:
            unit = _UNITS[mode][joint.unit]
        low, high = -_UNLIMITED, _UNLIMITED
        if model.actuator_ctrllimited[index]:
            low, high = map(float, model.actuator_ctrlrange[index])
        moved = tuple(int(dof) for dof in np.flatnonzero(moments[index]))
        name = distinct(plain(model.actuator(index).name) or f"actuator_{index}", taken)
        found.append(Drive(name, index, mode, unit, low, high, joint, moved, ratio, offset))
    return found


def _mode(model: Any, index: int) -> Mode:
    gain, bias = model.actuator_gaintype[index], model.actuator_biastype[index]
    if gain != _FIXED:
        return "other"
    integrates = model.actuator_dyntype[index] == _INTEGRATOR
    if bias == _UNBIASED:
        return "other" if integrates else "torque"
    if bias != _AFFINE:
        return "other"
    _, stiffness, damping = model.actuator_biasprm[index][:3]
    if stiffness:
        return "velocity" if integrates else "position"
    return "velocity" if damping and model.actuator_gainprm[index][0] == -damping else "torque"


def _ratio(model: Any, index: int, mode: Mode) -> tuple[float, float]:
    """Return the control per unit of the joint, and the control at zero."""
    gear, gain = float(model.actuator_gear[index][0]), float(model.actuator_gainprm[index][0])
    constant, stiffness, _ = map(float, model.actuator_biasprm[index][:3])
    if not gear or not gain:
        return 1.0, 0.0
    match mode:
        case "torque":
            return 1.0 / (gear * gain), 0.0
        case "velocity" if not stiffness:
            return gear, 0.0
        case "position" | "velocity":
            return -stiffness * gear / gain, -constant / gain if mode == "position" else 0.0
        case _:
            return 1.0, 0.0


def _moments(model: Any) -> Any:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    moments = np.zeros((model.nu, model.nv))
    if model.nu:
        mujoco.mju_sparse2dense(
            moments,
            data.actuator_moment.reshape(-1),
            data.moment_rownnz,
            data.moment_rowadr,
            data.moment_colind.reshape(-1),
        )
    return moments


def robot_dofs(model: Any, driven: list[Drive]) -> Any:
    """Return the robot's degrees of freedom: those of every kinematic tree with an actuator.

    Other objects in the model may still move when the robot is at rest.
    """
    trees = {int(model.dof_treeid[dof]) for drive in driven for dof in drive.dofs}
    if not trees:
        return np.arange(model.nv)
    return np.flatnonzero(np.isin(model.dof_treeid, list(trees)))
