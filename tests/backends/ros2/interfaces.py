"""Real ROS 2 interface packages that no registry has, built with rosidl's own generators and a C compiler.

`nav2_msgs` and `control_msgs` come with a ROS installation only. Run as `python interfaces.py ROOT` with ROS's
prefix in AMENT_PREFIX_PATH; `built()` does that once in a run of `make test`, or once a process.
"""

from __future__ import annotations

import atexit
import ctypes
import fcntl
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import types
import warnings
from functools import lru_cache
from pathlib import Path
from typing import Any

SHARED = "RCP_SHARED"
"""The variable of the environment that names the folder which the processes of a run share."""
_POINT = "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
_LIMITS = "float64 position\nfloat64 velocity\nfloat64 acceleration\n"
PACKAGES = {  # a package comes after those that it refers to
    "trajectory_msgs": {
        "msg/JointTrajectoryPoint": f"{_POINT}builtin_interfaces/Duration time_from_start\n",
        "msg/JointTrajectory": """\
std_msgs/Header header
string[] joint_names
JointTrajectoryPoint[] points
""",
        "msg/MultiDOFJointTrajectoryPoint": """\
geometry_msgs/Transform[] transforms
geometry_msgs/Twist[] velocities
geometry_msgs/Twist[] accelerations
builtin_interfaces/Duration time_from_start
""",
        "msg/MultiDOFJointTrajectory": """\
std_msgs/Header header
string[] joint_names
MultiDOFJointTrajectoryPoint[] points
""",
    },
    "control_msgs": {
        "msg/JointTolerance": f"string name\n{_LIMITS}",
        "msg/JointComponentTolerance": f"""\
uint16 X_AXIS=1
uint16 Y_AXIS=2
uint16 Z_AXIS=3
uint16 TRANSLATION=4
uint16 ROTATION=5
string joint_name
uint16 component
{_LIMITS}""",
        "action/FollowJointTrajectory": """\
trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
JointTolerance[] path_tolerance
JointComponentTolerance[] component_path_tolerance
JointTolerance[] goal_tolerance
JointComponentTolerance[] component_goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
---
int32 error_code
int32 SUCCESSFUL = 0
int32 INVALID_GOAL = -1
int32 INVALID_JOINTS = -2
int32 OLD_HEADER_TIMESTAMP = -3
int32 PATH_TOLERANCE_VIOLATED = -4
int32 GOAL_TOLERANCE_VIOLATED = -5
string error_string
---
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
""",
    },
    "nav2_msgs": {
        "msg/SpeedLimit": "std_msgs/Header header\nbool percentage\nfloat64 speed_limit\n",
        "action/NavigateToPose": """\
geometry_msgs/PoseStamped pose
string behavior_tree
---
uint16 NONE=0
uint16 error_code
string error_msg
---
geometry_msgs/PoseStamped current_pose
builtin_interfaces/Duration navigation_time
builtin_interfaces/Duration estimated_time_remaining
int16 number_of_recoveries
float32 distance_remaining
""",
    },
}
"""As in Kilted."""
_NEEDS = (
    "builtin_interfaces",
    "geometry_msgs",
    "action_msgs",
    "unique_identifier_msgs",
    "service_msgs",
    "std_msgs",
)
_SUPPORTS = ("fastrtps_c", "introspection_c", "c")


def have_tools() -> bool:
    """Tell whether they can be built here."""
    wheels = Path(sys.prefix, "share", "rosidl_generator_c").is_dir()
    return wheels and all(map(shutil.which, ("gcc", "g++")))


@lru_cache(maxsize=1)
def built() -> Path:
    """Build the packages and make them importable in this process; return their folder."""
    root = built_apart()
    use(root)
    return root


@lru_cache(maxsize=1)
def built_apart() -> Path:
    """Build the packages for other processes; return their folder."""
    root = _folder()
    with (root / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (root / "done").exists():
            _build_apart(root)
            (root / "done").touch()
    return root


def _folder() -> Path:
    """Return the folder that the processes of a run share, or one of this process alone."""
    if (shared := os.environ.get(SHARED)) is not None:
        root = Path(shared, "ros-interfaces")
        root.mkdir(exist_ok=True)
        return root
    root = Path(tempfile.mkdtemp(prefix="rcp-ros-interfaces-"))
    atexit.register(shutil.rmtree, root, ignore_errors=True)
    return root


def _build_apart(root: Path) -> None:
    """Build them in a process of its own: the generators change what is imported."""
    environment = os.environ | {
        "AMENT_PREFIX_PATH": sys.prefix,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    }
    done = subprocess.run(
        [sys.executable, __file__, str(root)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-4000:]


def use(root: Path) -> None:
    """Make built packages importable in this process."""
    for name in PACKAGES:
        supports = (f"rosidl_typesupport_{support}" for support in _SUPPORTS)
        for part in ("rosidl_generator_c", *supports, "rosidl_generator_py"):
            ctypes.CDLL(str(root / f"lib{name}__{part}.so"), mode=ctypes.RTLD_GLOBAL)
    sys.path.append(str(root))


def _build(root: Path) -> None:
    _stand_in_for_catkin()
    known: list[str] = []
    for package, texts in PACKAGES.items():
        _generate(root, package, texts)
        _compile(root, package, known)
        known.append(package)


def _stand_in_for_catkin() -> None:
    """Stand in for what rosidl's adapter imports to read a `package.xml`: there is none."""

    def nothing(name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)

    module = types.ModuleType("catkin_pkg.package")
    module.__getattr__ = nothing
    sys.modules |= {"catkin_pkg": types.ModuleType("catkin_pkg"), "catkin_pkg.package": module}


def _generate(root: Path, package: str, texts: dict[str, str]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from rosidl_generator_c.cli import GenerateC
        from rosidl_generator_py.cli import GeneratePython
        from rosidl_typesupport_c.cli import GenerateCTypesupport
        from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
        from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    source, share = root / "source" / package, root / "share"
    files = [f"{name}.{name.partition('/')[0]}" for name in texts]
    for file, text in zip(files, texts.values(), strict=True):
        (source / file).parent.mkdir(parents=True, exist_ok=True)
        (source / file).write_text(text)
    share.mkdir(exist_ok=True)
    os.chdir(source)
    for kind in (
        GenerateC,
        GeneratePython,
        GenerateFastRTPSCTypesupport,
        GenerateIntrospectionCTypesupport,
        GenerateCTypesupport,
    ):
        apart = kind is GenerateIntrospectionCTypesupport  # its files have the names of another's
        out = (root / "introspection" if apart else root) / package
        kind(kind.__name__).generate(package, files, [Path(sys.prefix, "share"), share], out)
    (root / package / "__init__.py").touch()
    for made in (root / package / "tmp", root / package):  # for packages that refer to it
        for ending in ("idl", "json"):
            for path in made.glob(f"msg/*.{ending}"):
                (share / package / "msg").mkdir(parents=True, exist_ok=True)
                shutil.copy(path, share / package / "msg")


def _compile(root: Path, package: str, known: list[str]) -> None:
    import numpy as np

    prefix = Path(sys.prefix)
    folders = [
        root,
        root / "introspection",
        prefix / "include",
        *(p for p in (prefix / "include").iterdir() if p.is_dir()),
    ]
    folders += [Path(sysconfig.get_paths()["include"]), Path(np.get_include())]
    flags = ["-shared", "-fPIC", "-O0", "-w", f"-L{prefix / 'lib'}", f"-L{root}"]
    flags += [f"-I{folder}" for folder in folders]
    needs = (*_NEEDS, *known)

    def link(part: str, compiler: str, sources: list[Path], *libraries: str) -> None:
        name = f"lib{package}__{part}.so"
        wanted = [f"-l{one}" for one in libraries]
        order = [
            compiler,
            *map(str, sources),
            *flags,
            f"-Wl,-soname,{name}",
            "-o",
            str(root / name),
        ]
        subprocess.run([*order, *wanted], check=True)

    def all_of(part: str) -> list[str]:
        return [f"{one}__{part}" for one in needs]

    own, base = f"{package}__rosidl_generator_c", all_of("rosidl_generator_c")
    runtime = ("rosidl_runtime_c", "rcutils")
    plain = [
        path
        for end in ("functions", "description", "type_support")
        for path in (root / package).glob(f"*/detail/*__{end}.c")
    ]
    inner = [*(root / "introspection" / package).rglob("*__type_support.c")]
    link("rosidl_generator_c", "gcc", plain, *base, *all_of("rosidl_typesupport_c"), *runtime)
    fast = [*(root / package).glob("*/detail/*__type_support_c.cpp")]
    link(
        "rosidl_typesupport_fastrtps_c", "g++", fast, own, *base,
        *all_of("rosidl_typesupport_fastrtps_c"), "rosidl_typesupport_fastrtps_c",
        "rosidl_typesupport_fastrtps_cpp", "fastcdr", "rmw",
    )  # fmt: skip
    link(
        "rosidl_typesupport_introspection_c", "gcc", inner, own, *base,
        *all_of("rosidl_typesupport_introspection_c"), "rosidl_typesupport_introspection_c",
        *runtime,
    )  # fmt: skip
    chosen = [*(root / package).glob("*/*__type_support.cpp")]
    link(
        "rosidl_typesupport_c", "g++", chosen, own, *base, *all_of("rosidl_typesupport_c"),
        "rosidl_typesupport_c", *runtime,
    )  # fmt: skip
    link(
        "rosidl_generator_py", "gcc", [*(root / package).glob("*/_*_s.c")], own, *base,
        *all_of("rosidl_generator_py"), *runtime,
    )  # fmt: skip
    link(
        "python", "gcc", [root / package / f"_{package}_s.ep.rosidl_typesupport_c.c"], own,
        f"{package}__rosidl_generator_py", f"{package}__rosidl_typesupport_c", *base,
        *all_of("rosidl_typesupport_c"), *runtime,
    )  # fmt: skip
    made = root / f"lib{package}__python.so"
    made.rename(root / package / f"{package}_s__rosidl_typesupport_c.so")


if __name__ == "__main__":
    _build(Path(sys.argv[1]))
