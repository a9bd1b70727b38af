"""Real ROS 2 interface packages that no registry has, built with rosidl's own generators and a C compiler.

`nav2_msgs` comes with a ROS installation only. Run as `python interfaces.py ROOT` with ROS's
prefix in AMENT_PREFIX_PATH; `built()` does that once a run.
"""

from __future__ import annotations

import atexit
import ctypes
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

ACTIONS = {
    "nav2_msgs/action/NavigateToPose": """\
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
}
"""As in Kilted."""
_NEEDS = ("builtin_interfaces", "geometry_msgs", "action_msgs", "unique_identifier_msgs")
_ALSO = ("service_msgs", "std_msgs")
_SUPPORTS = ("fastrtps_c", "introspection_c", "c")


def have_tools() -> bool:
    """Tell whether they can be built here."""
    wheels = Path(sys.prefix, "share", "rosidl_generator_c").is_dir()
    return wheels and all(map(shutil.which, ("gcc", "g++")))


@lru_cache(maxsize=1)
def built() -> Path:
    """Build the packages and make them importable in this process; return their folder."""
    root = Path(tempfile.mkdtemp(prefix="rcp-ros-interfaces-"))
    atexit.register(shutil.rmtree, root, ignore_errors=True)
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
    use(root)
    return root


def use(root: Path) -> None:
    """Make built packages importable in this process."""
    for name in sorted({action.partition("/")[0] for action in ACTIONS}):
        for part in ("rosidl_generator_c", *(f"rosidl_typesupport_{s}" for s in _SUPPORTS)):
            ctypes.CDLL(str(root / f"lib{name}__{part}.so"), mode=ctypes.RTLD_GLOBAL)
    sys.path.append(str(root))


def _build(root: Path) -> None:
    _stand_in_for_catkin()
    for action, text in ACTIONS.items():
        package, _, leaf = action.split("/")
        _generate(root, package, leaf, text)
        _compile(root, package)


def _stand_in_for_catkin() -> None:
    """Stand in for what rosidl's adapter imports to read a `package.xml`: there is none."""

    def nothing(name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)

    module = types.ModuleType("catkin_pkg.package")
    module.__getattr__ = nothing
    sys.modules |= {"catkin_pkg": types.ModuleType("catkin_pkg"), "catkin_pkg.package": module}


def _generate(root: Path, package: str, leaf: str, text: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from rosidl_generator_c.cli import GenerateC
        from rosidl_generator_py.cli import GeneratePython
        from rosidl_typesupport_c.cli import GenerateCTypesupport
        from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
        from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    source = root / "source" / package
    (source / "action").mkdir(parents=True)
    (source / "action" / f"{leaf}.action").write_text(text)
    os.chdir(source)
    for kind in (
        GenerateC,
        GeneratePython,
        GenerateFastRTPSCTypesupport,
        GenerateIntrospectionCTypesupport,
        GenerateCTypesupport,
    ):
        share = Path(sys.prefix, "share")
        apart = kind is GenerateIntrospectionCTypesupport  # its files have the names of another's
        out = (root / "introspection" if apart else root) / package
        kind(kind.__name__).generate(package, [f"action/{leaf}.action"], [share], out)
    (root / package / "__init__.py").touch()


def _compile(root: Path, package: str) -> None:
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
    detail = root / package / "action" / "detail"
    needs = (*_NEEDS, *_ALSO)

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
        for path in detail.glob(f"*__{end}.c")
    ]
    inner = [*(root / "introspection" / package).rglob("*__type_support.c")]
    link("rosidl_generator_c", "gcc", plain, *base, *all_of("rosidl_typesupport_c"), *runtime)
    fast = [*detail.glob("*__type_support_c.cpp")]
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
    chosen = [*(root / package / "action").glob("*__type_support.cpp")]
    link(
        "rosidl_typesupport_c", "g++", chosen, own, *base, *all_of("rosidl_typesupport_c"),
        "rosidl_typesupport_c", *runtime,
    )  # fmt: skip
    python = [
        *(root / package / "action").glob("_*_s.c"),
        root / package / f"_{package}_s.ep.rosidl_typesupport_c.c",
    ]
    link(
        "python", "gcc", python, own, f"{package}__rosidl_typesupport_c", *base,
        *all_of("rosidl_typesupport_c"), *all_of("rosidl_generator_py"), *runtime,
    )  # fmt: skip
    made = root / f"lib{package}__python.so"
    made.rename(root / package / f"{package}_s__rosidl_typesupport_c.so")


if __name__ == "__main__":
    _build(Path(sys.argv[1]))
