"""Ports in shared memory that killed processes left half made.

Everything runs with a shared memory of its own, which only root has without more ado: port 7000
belongs to all domains, and so to other tests too.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from backends.ros2.robot import BOUND, fresh_domain
from configuration import backend, listener, table
from rcp_ros2.shared_memory import remove_half_made

ALONE = ["unshare", "--mount", "sh", "-c"]
MOUNT = "mount -t tmpfs -o mode=1777 none /dev/shm"
ZEROS = "head -c 52400 /dev/zero > /dev/shm/fastdds_port7000"
HANGS = 2.0  # s for which a node is created in vain: without damage it takes a tenth of that
DAMAGE = (
    ": > /dev/shm/fastdds_port7000",
    ZEROS,
    f"{ZEROS}; printf '\\001' | dd of=/dev/shm/fastdds_port7000 conv=notrunc 2> /dev/null",
)
"""What a process leaves that is killed before its port has a size, before it begins to fill it, or while."""
NODE = (
    "import rclpy; rclpy.init(); print('began', flush=True); rclpy.create_node('n'); print('there')"
)
CLEAR = "from rcp_ros2.shared_memory import remove_half_made; remove_half_made(); print('there')"
WITHOUT_RIGHTS = "setpriv --inh-caps=-all --bounding-set=-all"

pytestmark = pytest.mark.skipif(
    subprocess.run([*ALONE, MOUNT], check=False, capture_output=True).returncode != 0,
    reason="a shared memory of its own needs the right to mount one",
)


@pytest.fixture(scope="module")
def domain() -> int:
    return fresh_domain()


def run(damage: str, command: str, domain: int, timeout: float) -> str:
    """Run Python code where the damage is; return what it printed, also if it was killed."""
    python = [*ALONE, f'{MOUNT}; {damage}; exec {command} "$@"', "sh", sys.executable, "-c"]
    code = NODE if command == "" else CLEAR
    environment = os.environ | {"ROS_DOMAIN_ID": str(domain)}
    with subprocess.Popen(
        [*python, code], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        began = process.stdout.readline() if command == "" else ""
        try:
            out, error = process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            process.kill()
            return began + "killed"
    return began + out + error


@contextmanager
def gateway(damage: str, config: Path, text: str) -> Iterator[str]:
    """Serve a configuration where the damage is."""
    config.write_text(text)
    rcpd = Path(sys.executable).with_name("rcpd")
    serve = [*ALONE, f'{MOUNT}; {damage}; exec "$@"', "sh", str(rcpd), "serve", str(config)]
    with subprocess.Popen(serve, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        line = next(line for line in process.stderr if "serving on " in line)
        reading = threading.Thread(target=process.stderr.read, daemon=True)
        reading.start()
        try:
            yield line.rpartition(" ")[2].strip()
        finally:
            process.terminate()
            process.wait(timeout=BOUND)
            reading.join(BOUND)


def test_a_node_hangs_at_a_port_that_is_half_made(domain: int) -> None:
    def create(damage: str) -> str:
        return run(damage, "", domain, HANGS)

    with ThreadPoolExecutor() as pool:
        assert set(pool.map(create, DAMAGE)) == {"began\nkilled"}


def test_a_gateway_starts_all_the_same_and_stops_its_other_robots_meanwhile(
    domain: int, tmp_path: Path
) -> None:
    text = (
        listener()
        + table("anonymous", role="admin")
        + backend("rover", use="sim", tenant="beta")
        + backend("robot", use="ros2", domain_id=domain)
    )
    with gateway(ZEROS, tmp_path / "rcp.toml", text) as url, httpx.Client(base_url=url) as client:

        def states() -> dict[str, str]:
            found = client.get("/rcp/v1/context/system/status").raise_for_status().json()
            return {one["name"]: one["state"] for one in found["body"]["backends"]}

        assert states()["robot"] == "starting"
        stopped = client.post("/rcp/v1/context/system/estop", json={"scope": "rover"})
        assert stopped.json()["status"] == "completed", stopped.text
        assert states()["robot"] == "starting", "the stop of another robot waited for it"
        end = threading.Event()
        for _ in range(int(BOUND / 0.1)):
            if states()["robot"] == "ready":
                break
            end.wait(0.1)
        assert states()["robot"] == "ready"


def test_what_cannot_be_opened_does_no_harm(domain: int) -> None:
    foreign = f"{ZEROS}; chown 65534 /dev/shm /dev/shm/fastdds_port7000"
    assert "there" in run(foreign, WITHOUT_RIGHTS, domain, BOUND)


def test_what_only_another_user_may_remove_is_told(domain: int) -> None:
    foreign = f"{ZEROS}; chmod 666 /dev/shm/fastdds_port7000; chown 65534 /dev/shm /dev/shm/*"
    told = run(foreign, WITHOUT_RIGHTS, domain, BOUND)
    assert "sudo rm /dev/shm/fastdds_port7000" in told


def test_only_ports_that_are_half_made_are_removed(tmp_path: Path) -> None:
    for name in ("fastdds_port7000", "fastrtps_port7413"):
        (tmp_path / name).write_bytes(b"\2\0\0\0" + bytes(100))
    (tmp_path / "fastdds_port7000_el").touch()  # a lock, which is always empty
    (tmp_path / "fastdds_0123456789abcdef").touch()  # belongs to one process, and nobody waits
    before = set(tmp_path.iterdir())
    (tmp_path / "fastdds_port7001").touch()
    (tmp_path / "fastdds_port7002").write_bytes(bytes(100))
    (tmp_path / "fastrtps_port7003").write_bytes(b"\1\0\0\0" + bytes(100))
    remove_half_made(tmp_path)
    assert set(tmp_path.iterdir()) == before
