"""Loading of a model file: MJCF, or URDF with added actuators."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from rcp_kernel.errors import ConfigError
from rcp_mujoco.bindings import mujoco

__all__ = ["load_model"]

_FREE = (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL)
_STIFFNESS = 200.0  # N.m/rad of an added position actuator
_DAMPING = 20.0  # N.m.s/rad of an added velocity actuator
_FASTEST = 10.0  # rad/s or m/s
_STRONGEST = 100.0  # N.m or N


def load_model(path: Path, actuate: Literal["position", "velocity", "torque"] | None) -> Any:
    """Compile a model; MuJoCo's own reset of an unstable simulation is switched off.

    :raises ConfigError: the file is missing, or not a valid model.
    """
    if not path.is_file():
        raise ConfigError(f"model: there is no file {path}")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        added = _add_actuators(spec, actuate) if actuate is not None else []
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise ConfigError(f"model: {path} is not a model that MuJoCo can load: {error}") from error
    if not model.nv:
        raise ConfigError(f"model: nothing in {path} can move: it has no joints")
    if model.opt.timestep <= 0:
        raise ConfigError(f"model: the timestep of {path} is {model.opt.timestep:g} s")
    if actuate == "position":
        _bound(model, added)
    if actuate is not None:  # strong actuators on light links need it
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    mujoco.set_mju_user_warning(_ignore)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return model


def _add_actuators(spec: Any, kind: str) -> list[str]:
    """Add actuators; return the names of their joints, which are theirs as well."""
    added: list[str] = []
    driven = {actuator.target for actuator in spec.actuators}
    for joint in spec.joints:
        if joint.type in _FREE or joint.name in driven:
            continue
        actuator = spec.add_actuator(
            name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        added.append(joint.name)
        low, high = -_FASTEST, _FASTEST
        if kind == "position":
            actuator.set_to_position(kp=_STIFFNESS, dampratio=1.0)
        elif kind == "velocity":
            actuator.set_to_velocity(kv=_DAMPING)
        else:
            actuator.set_to_motor()
            low, high = -_STRONGEST, _STRONGEST
        actuator.ctrlrange = (low, high)
        actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
    return added


def _bound(model: Any, added: list[str]) -> None:
    """Bound positions by the joints' limits, which are in rad only once they are compiled."""
    for name in added:
        joint = model.joint(name)
        if model.jnt_limited[joint.id]:
            model.actuator(name).ctrlrange[:] = joint.range


def _ignore(_: str) -> None:
    """Keep MuJoCo from writing warnings to a file: the simulation looks at their counters."""
