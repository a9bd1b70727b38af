"""Install each way that `dist/` offers, and drive a robot with what was installed.

    python packaging/verify.py [--partial] [wheels] [pipx] [uv] [sdist] [npm] [deb] [container] [ros2] [sbom] [docs]

Prints for each way the seconds from nothing to a robot that has driven, and those of CPU, which other programs change less. A way for which this machine has no tool is told, and
is a failure if it was named. So is an image that is not in `dist/` although this machine has the builder, unless `--partial` is given. The Debian package is installed in a bare Debian system: a folder given by `RCP_CHROOT`, made
by debootstrap with python3, adduser and ca-certificates. `ros2` needs colcon (colcon-core, colcon-ros, colcon-bash); what its launch
file starts is started without `ros2 launch`, for which there are no wheels.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import secrets
import select
import shutil
import socket
import subprocess
import sys
import tarfile
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from build import DIST, EXTRAS, ROOT, VERSION

_GATEWAY = DIST / f"rcp_gateway-{VERSION}-py3-none-any.whl"
_CLIENT = DIST / f"rcp_client-{VERSION}-py3-none-any.whl"
_START = 60.0  # s until a gateway serves
_STOP = 30.0  # s until one has ended
_DRIVE = 30.0  # s until a ROS 2 node has driven
_ROVER = """import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry

rclpy.init()
node = rclpy.create_node("rover")
odometry = Odometry()
told = node.create_publisher(Odometry, "/odom", 10)

def move():
    odometry.header.stamp = node.get_clock().now().to_msg()
    odometry.pose.pose.position.x += odometry.twist.twist.linear.x * 0.05
    told.publish(odometry)

def steer(twist):
    odometry.twist.twist = twist

node.create_subscription(Twist, "/cmd_vel", steer, 10)
node.create_timer(0.05, move)
rclpy.spin(node)
"""
_GOAL = '{"position": {"x": 0.5, "y": 0}}'


_LONGEST = 1800.0  # s that any program may take


class Missing(Exception):
    """A tool that this machine does not have."""


class Absent(Missing):
    """A part of the release that was not built, although this machine could have."""


def run(*command: str | Path, **environment: str) -> str:
    """Run a program outside of the tree, and return what it prints."""
    words = [str(part) for part in command]
    kept = {name: value for name, value in os.environ.items() if not name.startswith("RCP_")}
    try:
        done = subprocess.run(  # noqa: S603 - programs of this script
            words,
            cwd="/",
            env=kept | environment,
            check=False,
            capture_output=True,
            text=True,
            timeout=_LONGEST,
        )
    except subprocess.TimeoutExpired as error:
        raise SystemExit(f"{' '.join(words)}: has not ended after {error.timeout:g} s") from None
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(words)}: {done.stdout}{done.stderr}")
    return done.stdout


def tool(name: str) -> str:
    """Return where a program is."""
    found = shutil.which(name, path=f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    if found is None:
        raise Missing(name)
    return found


@contextmanager
def serving(command: Sequence[str | Path], folder: Path | None = None) -> Generator[None]:
    """Run a gateway until the block ends; enter when it serves."""
    with subprocess.Popen(  # noqa: S603
        [str(part) for part in command],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    ) as process:
        try:
            _wait(process)
            yield
        finally:
            process.terminate()
            try:
                process.wait(_STOP)
            except subprocess.TimeoutExpired:
                process.kill()


@contextmanager
def cleanup(*command: str | Path, **environment: str) -> Generator[None]:
    """Run a program when the block has ended; what went wrong in the block is told all the same."""
    try:
        yield
    except BaseException:
        try:
            run(*command, **environment)
        except SystemExit as also:
            print(f"then also: {also}", file=sys.stderr)
        raise
    run(*command, **environment)


def _wait(process: subprocess.Popen[bytes]) -> None:
    assert process.stdout is not None
    out, end = b"", time.monotonic() + _START
    while b"rcpd: serving" not in out:
        ready, _, _ = select.select([process.stdout], [], [], max(0.0, end - time.monotonic()))
        chunk = os.read(process.stdout.fileno(), 65536) if ready else b""
        if not chunk:
            raise SystemExit(f"the gateway does not serve: {out.decode()}")
        out += chunk


def free_port() -> str:
    """Return a port that nothing listens on."""
    with socket.socket() as made:
        made.bind(("127.0.0.1", 0))
        return str(made.getsockname()[1])


def drive(rcpctl: Sequence[str | Path], **environment: str) -> None:
    """Drive the simulated robot, and make sure that it went where it should."""
    done = json.loads(run(*rcpctl, "execute", "/action/move_to", _GOAL, "--json", **environment))
    place = json.loads(run(*rcpctl, "read", "/sensor/pose", "--json", **environment))
    there = place.get("body", place)["position"]["x"]
    if not 0.3 < there < 0.7:
        raise SystemExit(f"the robot is not where it was sent: {done}, {place}")


def drive_from(programs: Path, scratch: Path) -> None:
    """Write a configuration with installed programs, serve it and drive."""
    folder, port = scratch / "gateway", free_port()
    run(programs / "rcpd", "init", "--yes", "--into", folder, "--port", port)
    key = (folder / "operator.key").read_text(encoding="utf-8").strip()
    with serving([programs / "rcpd", "serve", folder / "rcp.toml"]):
        drive([programs / "rcpctl"], RCP_URL=f"http://127.0.0.1:{port}", RCP_TOKEN=key)


def _pins(scratch: Path) -> Path:
    """Write constraints by which our own packages are those of `dist/`, whatever an index has."""
    pins = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    own = f"rcp-client @ {_CLIENT.as_uri()}\nrcp-gateway @ {_GATEWAY.as_uri()}\n"
    path = scratch / "constraints.txt"
    path.write_text(pins + own, encoding="utf-8")
    return path


def _environment(scratch: Path, gateway: Path, client: Path, extras: str = "") -> Path:
    """Make a virtual environment; return its programs."""
    run(sys.executable, "-m", "venv", scratch / "venv")
    programs = scratch / "venv" / "bin"
    pins = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    (scratch / "pins.txt").write_text(pins, encoding="utf-8")
    pip = (programs / "python", "-m", "pip", "install", "-q", "--disable-pip-version-check")
    run(*pip, "-c", scratch / "pins.txt", client, f"{gateway}{extras}", RCP_DASHBOARD="off")
    return programs


def wheels(scratch: Path) -> None:
    """Install the wheels by pip."""
    drive_from(_environment(scratch, _GATEWAY, _CLIENT), scratch)


def sdist(scratch: Path) -> None:
    """Install from the sources."""
    sources = (DIST / f"{name}-{VERSION}.tar.gz" for name in ("rcp_gateway", "rcp_client"))
    drive_from(_environment(scratch, *sources), scratch)


def pipx(scratch: Path) -> None:
    """Install both programs by pipx."""
    homes = {"PIPX_HOME": str(scratch / "pipx"), "PIPX_BIN_DIR": str(scratch / "bin")}
    pins = f"-c {_pins(scratch)}"
    for wheel in (_GATEWAY, _CLIENT):
        run(tool("pipx"), "install", "--pip-args", pins, wheel, **homes)
    drive_from(scratch / "bin", scratch)


def uv(scratch: Path) -> None:
    """Install both programs by uv, with a Python that is there."""
    homes = {"UV_TOOL_DIR": str(scratch / "uv"), "UV_TOOL_BIN_DIR": str(scratch / "bin")}
    python = ("--python", sys.executable, "--no-python-downloads")
    pins = ("-c", ROOT / "constraints.txt")
    for wheel, beside in ((_GATEWAY, ("--with", _CLIENT)), (_CLIENT, ())):
        run(tool("uv"), "tool", "install", "-q", *python, *pins, *beside, wheel, **homes)
    drive_from(scratch / "bin", scratch)


def npm(scratch: Path) -> None:
    """Install the npm package, and drive with it from Node 22 or later."""
    if int(run(tool("node"), "--version").strip().lstrip("v").partition(".")[0]) < 22:
        raise Missing("Node 22")
    programs = _environment(scratch, _GATEWAY, _CLIENT)
    folder, port = scratch / "gateway", free_port()
    run(programs / "rcpd", "init", "--yes", "--into", folder, "--port", port)
    (scratch / "package.json").write_text('{"type": "module"}', encoding="utf-8")
    run(tool("npm"), "--prefix", scratch, "install", "--silent", DIST / f"rcp-client-{VERSION}.tgz")
    (scratch / "drive.js").write_text(
        f"""import {{ Client }} from "rcp-client";
const robot = new Client({{ url: process.env.RCP_URL, token: process.env.RCP_TOKEN, tenant: "main" }});
await robot.connect();
await robot.execute("/action/move_to", {_GOAL}).result;
const {{ value }} = await robot.read("/sensor/pose");
if (Math.abs(value.position.x - 0.5) > 0.2) throw new Error(JSON.stringify(value));
robot.close();
""",
        encoding="utf-8",
    )
    key = (folder / "operator.key").read_text(encoding="utf-8").strip()
    with serving([programs / "rcpd", "serve", folder / "rcp.toml"]):
        where = {"RCP_URL": f"http://127.0.0.1:{port}", "RCP_TOKEN": key}
        run(tool("node"), scratch / "drive.js", **where)


def deb(_scratch: Path) -> None:
    """Install the package in a bare Debian system, drive as its user, and purge it."""
    root = os.environ.get("RCP_CHROOT")
    if root is None or os.geteuid() != 0:
        raise Missing("RCP_CHROOT, and root to enter it")
    (package,) = DIST.glob("*.deb")
    shutil.copy(package, Path(root) / "tmp")
    inside = (tool("chroot"), root)
    path = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
    run(tool("mount"), "-t", "proc", "proc", f"{root}/proc")  # by which the gateway measures itself
    with (
        cleanup(tool("umount"), f"{root}/proc"),
        cleanup(*inside, "dpkg", "--purge", "rcp-gateway", PATH=path),
    ):
        run(*inside, "dpkg", "-i", f"/tmp/{package.name}", PATH=path)  # noqa: S108 - in that system
        key = (Path(root) / "etc/rcp/operator.key").read_text(encoding="utf-8").strip()
        port = free_port()
        user = (tool("chroot"), "--userspec=rcp:rcp", root, "/usr/bin/env", "HOME=/var/lib/rcp")
        with serving([*user, "rcpd", "serve", "--port", port, "/etc/rcp/rcp.toml"]):
            at = {"RCP_URL": f"http://127.0.0.1:{port}", "RCP_TOKEN": key, "PATH": path}
            drive([*inside, "rcpctl"], **at)
    for name in ("etc/rcp", "var/lib/rcp", "opt/rcp-gateway"):
        if (Path(root) / name).exists():
            raise SystemExit(f"the purged package left /{name}")


def container(_scratch: Path) -> None:
    """Start the image in `dist/`, or that of the name RCP_IMAGE, and drive within it."""
    program, image = tool("buildah"), os.environ.get("RCP_IMAGE")
    if image is None:
        archive = DIST / f"rcp-gateway-{VERSION}.oci.tar"
        if not archive.exists():
            raise Absent(archive.name)
        image = f"oci-archive:{archive}"
    buildah = (program, *os.environ.get("RCP_BUILDAH", "").split())
    name, port = run(*buildah, "from", image).strip(), free_port()
    with cleanup(*buildah, "rm", name):
        isolation = ("--isolation", os.environ.get("BUILDAH_ISOLATION", "chroot"))
        inside = (*buildah, "run", *isolation, name, "--")
        with serving([*inside, "env", f"RCP_PORT={port}", "/usr/local/bin/start"]):
            key = run(*inside, "cat", "operator.key").strip()
            at = ("env", f"RCP_URL=https://127.0.0.1:{port}", f"RCP_TOKEN={key}")
            drive([*inside, *at, "RCP_CACERT=tls/gateway.pem", "rcpctl"])


def ros2(scratch: Path) -> None:
    """Build the ROS 2 package in a workspace, and drive a node with what its launch file starts."""
    colcon, name = tool("colcon"), "rcp_gateway_ros"
    if sys.version_info[:2] != (3, 11):
        raise Missing("Python 3.11, which ROS 2 has wheels for")
    shutil.copytree(ROOT / "packaging" / "ros2" / name, scratch / "src" / name)
    folders = ("--build-base", scratch / "build", "--install-base", scratch / "install")
    run(colcon, "--log-base", scratch / "log", "build", "--base-paths", scratch / "src", *folders)
    programs = _environment(scratch, _GATEWAY, _CLIENT, "[ros2]")
    setup = f". {scratch}/install/setup.bash && exec "
    find = f"from ament_index_python import get_package_share_directory as of; print(of('{name}'))"
    share = run(tool("bash"), "-c", f'{setup}{programs}/python -c "{find}"').strip()
    (scratch / "rover.py").write_text(_ROVER, encoding="utf-8")
    port, key = free_port(), secrets.token_urlsafe(24)
    os.environ |= {"OPERATOR_KEY": key, "ROS_LOG_DIR": str(scratch / "log")}
    serve = f"{programs}/rcpd serve {share}/config/gateway.toml --port {port}"
    rover = subprocess.Popen([programs / "python", scratch / "rover.py"])  # noqa: S603
    try:
        with serving([tool("bash"), "-c", setup + serve]):
            _drive_node(programs / "rcpctl", RCP_URL=f"http://127.0.0.1:{port}", RCP_TOKEN=key)
    finally:
        rover.kill()
        rover.wait(_STOP)


def _drive_node(rcpctl: Path, **environment: str) -> None:
    """Drive until the odometry says so; before that, the node may not have been found."""
    end = time.monotonic() + _DRIVE
    while time.monotonic() < end:
        with suppress(SystemExit):
            run(rcpctl, "write", "/actuator/cmd_vel", '{"linear": {"x": 0.5}}', **environment)
            told = json.loads(run(rcpctl, "read", "/sensor/odom", "--json", **environment))
            if told.get("body", told)["pose"]["pose"]["position"]["x"] > 0:
                return
    raise SystemExit("the node did not drive")


def sbom(scratch: Path) -> None:
    """Compare the list of components with what the packages for people install."""
    listed = json.loads((DIST / f"rcp-gateway-{VERSION}.cdx.json").read_text(encoding="utf-8"))
    known = {(one["name"].lower(), one["version"]) for one in listed["components"]}
    programs = _environment(scratch, _GATEWAY, _CLIENT, f"[{EXTRAS}]")
    found = json.loads(run(programs / "python", "-m", "pip", "list", "--format", "json"))
    own = {"rcp-gateway", "rcp-client", "pip", "setuptools", "wheel"}
    installed = {(re.sub(r"[-_.]+", "-", one["name"]).lower(), one["version"]) for one in found}
    if missing := {one for one in installed - known if one[0] not in own}:
        raise SystemExit(f"the list of components lacks {sorted(missing)}")


def docs(scratch: Path) -> None:
    """Unpack the site; its links were checked when it was built."""
    with tarfile.open(DIST / f"rcp-gateway-docs-{VERSION}.tar.gz") as packed:
        packed.extractall(scratch, filter="data")
    for name in ("index.html", "protocol.html", "search/search_index.json"):
        if not (scratch / "site" / name).is_file():
            raise SystemExit(f"the site has no {name}")


WAYS: dict[str, Callable[[Path], None]] = {
    "wheels": wheels,
    "pipx": pipx,
    "uv": uv,
    "sdist": sdist,
    "npm": npm,
    "deb": deb,
    "container": container,
    "ros2": ros2,
    "sbom": sbom,
    "docs": docs,
}


def _cpu() -> float:
    """Return the seconds of CPU that the programs which have ended took."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Try what is named, or everything."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ways", nargs="*", metavar="WAY", help=", ".join(WAYS))
    parser.add_argument("--partial", action="store_true", help="a release may lack its container")
    given = parser.parse_args()
    named, absent = list[str](given.ways), list[str]()
    if unknown := [way for way in named if way not in WAYS]:
        parser.error(f"unknown: {', '.join(unknown)}")
    for way in named or WAYS:
        began, before = time.monotonic(), _cpu()
        try:
            with TemporaryDirectory() as scratch:
                WAYS[way](Path(scratch))
        except Missing as error:
            if named:
                raise SystemExit(f"{way}: needs {error}") from None
            absent += [str(error)] if isinstance(error, Absent) else []
            print(f"{way:<10} not tried: needs {error}", flush=True)
        else:
            seconds, cpu = time.monotonic() - began, _cpu() - before
            print(f"{way:<10} {seconds:6.1f} s, {cpu:5.1f} s of CPU", flush=True)
    if absent and not given.partial:
        raise SystemExit(f"this release has no {', '.join(absent)}: --partial allows that")


if __name__ == "__main__":
    main()
