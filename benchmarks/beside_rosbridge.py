"""The ROS 2 backend beside a bare server of the same work. Run: python benchmarks/beside_rosbridge.py

python benchmarks/beside_rosbridge.py [NAME…] runs only the cases so named: by the gateway's own protocol (`gateway`), and
by rosbridge at the gateway (`rosbridge`). The servers run on one core, publisher
and clients on the other; figures are per CPU-second of the server. rosbridge_suite is not on PyPI: where a
ROS 2 with it is sourced, RUN_ROSBRIDGE="ros2 launch rosbridge_server rosbridge_websocket_launch.xml port:={port}" has it
measured too (`suite`). BESIDE=TREE has the gateway of another working tree with a `.venv` of its own measured too (`beside`).
"""

from __future__ import annotations

import json
import os
import random
import shlex
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import NamedTuple

import psutil
from measure import line_of

from rcp_ros2 import PROFILE

HERE = Path(__file__).parent / "ros2"
SECONDS = 4.0
SUITE = os.environ.get("RUN_ROSBRIDGE", "")
BESIDE = os.environ.get("BESIDE", "")
ROSBRIDGE = {"json": "json", "native": "cbor-raw"}
"""The compression of rosbridge for an encoding of the gateway's own protocol."""
ROUNDS = int(os.environ.get("ROUNDS", "3"))
SERVER, OTHERS = [0], [1]


class Case(NamedTuple):
    name: str
    type: str
    rate: float
    clients: int
    size: int = 0
    encoding: str = "json"
    floor: str = "json"
    service: bool = False
    profile: bool = False
    """With the Fast DDS profile of the ROS 2 backend at the publisher."""


ODOM, IMAGE, CLOUD = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2"
CASES = (
    Case("odom-1", ODOM, 1000, 1),
    Case("odom-10", ODOM, 1000, 10),
    Case("odom-50", ODOM, 1000, 50),
    Case("odom-100hz-50", ODOM, 100, 50),
    Case("scan-10", "sensor_msgs/msg/LaserScan", 100, 10),
    Case("images-json", IMAGE, 30, 10),
    Case("images-binary", IMAGE, 30, 10, 0, "msgpack", "binary"),
    Case("images-native", IMAGE, 30, 10, 0, "native", "binary"),
    Case("images-profile", IMAGE, 30, 10, 0, "msgpack", "binary", profile=True),
    Case("clouds-json", CLOUD, 10, 1, 1_000_000),
    Case("clouds-binary", CLOUD, 10, 1, 1_000_000, "msgpack", "binary"),
    Case("clouds-profile", CLOUD, 10, 1, 1_000_000, "native", "binary", profile=True),
    Case("odom-cdr-10", ODOM, 1000, 10, 0, "cdr", "cdr"),
    Case("odom-cdr-50", ODOM, 1000, 50, 0, "cdr", "cdr"),
    Case("odom-raw-10", ODOM, 1000, 10, 0, "native", "cdr"),
    Case("images-cdr", IMAGE, 30, 10, 0, "cdr", "cdr"),
    Case("images-raw", IMAGE, 30, 10, 0, "native", "cdr"),
    Case("service", "", 0, 1, service=True),
    Case("service-10", "", 0, 10, service=True),
)
CONFIG = """
log = {{level = "error"}}
[transports.asgi]
port = {port}
[plugins.foxglove]
[anonymous]
role = "operator"
[plugins.rosbridge]
[[backends]]
use = "ros2"
tenant = "t"
[backends.map]
"/sensor/value" = {{ topic = "/value"{more} }}
"/service/reset" = {{ service = "/reset", type = "std_srvs/srv/Trigger" }}
"""


def free_port() -> int:
    with closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def environment() -> dict[str, str]:
    own = {
        "ROS_DOMAIN_ID": str(random.randint(1, 100)),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "HOME": os.environ.get("HOME", tempfile.gettempdir()),
        "ROS_LOG_DIR": tempfile.gettempdir(),
    }
    return {**os.environ, **own}


def open_port(port: int) -> None:
    end = time.monotonic() + 60  # s: a busy machine
    while time.monotonic() < end:
        with closing(socket.socket()) as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.05)
    sys.exit(f"no server on port {port}")


def run(case: Case, server: str) -> dict[str, float]:
    """Run one case against a server; return what arrived and what it cost."""
    port, env = free_port(), environment()
    with ExitStack() as stack:

        def start(
            cores: list[int], *command: str, more: dict[str, str] | None = None
        ) -> subprocess.Popen[bytes]:
            process = subprocess.Popen(
                command, env={**env, **(more or {})}, stdin=subprocess.PIPE, stdout=subprocess.PIPE
            )
            psutil.Process(process.pid).cpu_affinity(cores)
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        what = ["--service", "/reset"] if case.service else [case.type, "/value", str(case.rate)]
        size = ["--size", str(case.size)] if case.size else []
        more = {"FASTDDS_DEFAULT_PROFILES_FILE": str(PROFILE)} if case.profile else {}
        start(OTHERS, sys.executable, str(HERE / "publisher.py"), *what, *size, more=more)
        asked = [sys.executable, str(HERE / "client.py")]
        if server == "floor":
            follow = ["--service", "/reset"] if case.service else [case.type, "/value", case.floor]
            served = start(SERVER, sys.executable, str(HERE / "floor.py"), str(port), *follow)
            encoding = "msgpack" if case.floor == "binary" else case.floor
            asked += ["bare", f"ws://127.0.0.1:{port}", "--encoding", encoding]
        elif server == "suite":
            served = start(SERVER, *shlex.split(SUITE.format(port=port)))
            asked += [
                "rosbridge",
                f"ws://127.0.0.1:{port}",
                "--topic",
                "/value",
                "--type",
                case.type,
            ]
            asked += ["--encoding", ROSBRIDGE[case.encoding]]
        else:
            path = stack.enter_context(tempfile.NamedTemporaryFile("w", suffix=".toml"))
            typed = f', type = "{case.type}"' if case.type else ', type = "std_msgs/msg/Bool"'
            path.write(CONFIG.format(port=port, more=typed))
            path.flush()
            rcpd = f"{BESIDE}/.venv/bin/rcpd" if server == "beside" else "rcpd"
            served = start(SERVER, rcpd, "serve", path.name)
            if server == "rosbridge":
                asked += ["rosbridge", f"ws://127.0.0.1:{port}/rosbridge", "--topic", "/value"]
                asked += ["--encoding", ROSBRIDGE[case.encoding]]
            elif case.encoding == "cdr":
                asked += ["foxglove", f"ws://127.0.0.1:{port}/foxglove/t", "--topic", "/value"]
                asked += ["--encoding", case.encoding]
            else:
                asked += ["rcp", f"ws://127.0.0.1:{port}/rcp/v1/ws", "--encoding", case.encoding]
                asked += ["--topic", "/tenant/t/sensor/value"]
        open_port(port)
        if case.service:
            name = "/tenant/t/service/reset" if server in ("gateway", "beside") else "/reset"
            asked += ["--service", name]
            time.sleep(3.0)  # for discovery
        asked += ["--clients", str(case.clients), "--seconds", str(SECONDS), "--settle", "3"]
        client = start(OTHERS, *asked)
        info = psutil.Process(served.pid)
        assert client.stdout
        line_of(client)
        before = cpu_of(info)
        result = json.loads(line_of(client))
        cpu = cpu_of(info) - before
    return {**result, "cpu": cpu, "per_cpu": result["frames"] / max(cpu, 0.001)}


def cpu_of(process: psutil.Process) -> float:
    """Return the CPU time of a process and of those it has started, in s."""
    times = [one.cpu_times() for one in (process, *process.children(recursive=True))]
    return sum(one.user + one.system for one in times)


def show(case: Case, name: str, found: dict[str, float]) -> None:
    offered = case.rate * case.clients * found["seconds"]
    share = f"delivered {found['frames'] / offered:6.1%}" if offered else f"{found['frames']} calls"
    share += f" ({found['gaps']} gaps)" if found["gaps"] else ""
    print(
        f"  {name:8} {found['per_cpu'] / 1000:8.1f} k/CPU-s  cpu {found['cpu'] / found['seconds']:5.1%}"
        f"  {share}  {found['bytes'] / max(1, found['frames']):.0f} B  p50 {found['p50_ms']:7.2f} ms  p99 {found['p99_ms']:7.2f} ms",
        flush=True,
    )


def beside(case: Case) -> None:
    print(case.name, flush=True)
    names = ["floor", "gateway", *(["beside"] if BESIDE else [])]
    if case.encoding in ROSBRIDGE:
        names += ["rosbridge", "suite"] if SUITE else ["rosbridge"]
    found: dict[str, list[float]] = {name: [] for name in names}
    for _ in range(ROUNDS):
        for name in names:
            result = run(case, name)
            show(case, name, result)
            found[name].append(result["per_cpu"])
    medians = {name: sorted(values)[len(values) // 2] for name, values in found.items()}
    for name in names[1:]:
        text = f"  {name}: {medians[name] / max(medians['floor'], 0.001):.2f} of the floor"
        if name != "gateway":
            text += f", {medians[name] / max(medians['gateway'], 0.001):.2f} of the gateway's own protocol"
        print(text)


if __name__ == "__main__":
    known = {case.name: case for case in CASES}
    for name in sys.argv[1:] or known:
        beside(known[name])
