"""The files that a robot's description names, and no others."""

from __future__ import annotations

import os
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from backends.ros2.robot import Eyes, Robot, fresh_domain, robot_of
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceRejected,
    InvalidValue,
    PayloadTooLarge,
    RcpError,
)
from rcp_ros2.assets import find, packages_of
from rcp_ros2.config import Assets

FETCH = "service/assets/fetch"
NAMED = frozenset({"seen_description"})


@pytest.fixture(scope="module")
def disk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace with a package that is named, one that is not, and a secret."""
    root = tmp_path_factory.mktemp("workspace")
    for package in ("seen_description", "other"):
        (root / "share" / package / "meshes").mkdir(parents=True)
        (root / "share" / package / "meshes" / "base.stl").write_bytes(
            b"solid of " + package.encode()
        )
        index = root / "share" / "ament_index" / "resource_index" / "packages"
        index.mkdir(parents=True, exist_ok=True)
        (index / package).touch()
    (root / "secret.stl").write_text("secret")
    (root / "secret").write_text("secret")
    own = root / "share" / "seen_description"
    (own / "package.xml").write_text("<package/>")
    (own / "meshes" / "Big.STL").write_bytes(bytes(101))
    (own / "meshes" / "out.stl").symlink_to(root / "secret.stl")
    (own / "meshes" / "up").symlink_to(root)
    (own / "meshes" / "in.stl").symlink_to("base.stl")
    (own / "meshes" / "package.stl").symlink_to("../package.xml")
    (own / "meshes" / "ring.stl").symlink_to("ring.stl")
    (own / "meshes" / "folder.stl").mkdir()
    os.mkfifo(own / "meshes" / "pipe.stl")
    return root


def of(disk: Path, size: int = 100) -> Assets:
    return Assets(paths={"seen_description": str(disk / "share" / "seen_description")}, size=size)


def test_packages_are_those_that_the_description_takes_files_from() -> None:
    text = """<mesh filename="package://a_b/x.stl"/> <mesh filename='package://c/d/e.dae'/>
    <texture filename = "package://g/&quot;.png"/> package://not_named/x.stl <a b="file:///etc/passwd"/>"""
    assert packages_of(text) == {"a_b", "c", "g"}


@pytest.mark.parametrize("name", ["base.stl", "in.stl"])
def test_a_file_of_a_named_package_is_found(disk: Path, name: str) -> None:
    found = find(f"package://seen_description/meshes/{name}", NAMED, of(disk))
    assert found.read_bytes() == b"solid of seen_description"


@pytest.mark.parametrize(
    "uri",
    [
        "file:///etc/passwd",
        "http://127.0.0.1/x.stl",
        "/etc/passwd",
        "meshes/base.stl",
        "package://",
        "package:///etc/x.stl",
        "package://seen_description",
        "package://seen_description/",
        "package://seen_description//etc/x.stl",
        "package://seen_description/../../secret.stl",
        "package://seen_description/meshes/../../../secret.stl",
        "package://seen_description/meshes/./base.stl",
        "package://seen_description/meshes/.. /base.stl",
        "package://seen_description/meshes\\..\\base.stl",
        "package://seen_description/meshes/base.stl\0.png",
        "package://../share/other/meshes/base.stl",
        "package://other/meshes/base.stl",
        "package://seen_description/package.xml",
        "package://seen_description/meshes/base.stl/..",
        "PACKAGE://seen_description/meshes/base.stl",
    ],
)
def test_what_is_no_mesh_of_a_named_package_is_refused(disk: Path, uri: str) -> None:
    with pytest.raises(InvalidValue) as refused:
        find(uri, NAMED, of(disk))
    assert refused.value.remedy
    assert str(disk) not in refused.value.message


@pytest.mark.parametrize(
    "rest",
    [
        "out.stl",
        "up/secret.stl",
        "package.stl",
        "ring.stl",
        "folder.stl",
        "pipe.stl",
        "none.stl",
        "%2e%2e/%2e%2e/secret.stl",
        "base.stl/x.stl",
        f"{'x' * 300}.stl",
    ],
)
def test_no_link_leads_out_and_nothing_else_than_a_file_is_read(disk: Path, rest: str) -> None:
    with pytest.raises(DeviceRejected) as refused:
        find(f"package://seen_description/meshes/{rest}", NAMED, of(disk))
    assert str(disk) not in refused.value.message
    assert "assets.paths.seen_description" in (refused.value.remedy or "")


def test_a_file_that_is_too_large_is_refused_with_the_limit(disk: Path) -> None:
    big = "package://seen_description/meshes/Big.STL"
    with pytest.raises(PayloadTooLarge) as refused:
        find(big, NAMED, of(disk))
    assert refused.value.details == {"size": 101, "limit": 100}
    assert find(big, NAMED, of(disk, size=101)).name == "Big.STL"


def test_a_package_that_is_not_here_is_named_with_what_helps(disk: Path) -> None:
    for config in (Assets(), Assets(paths={"seen_description": str(disk / "gone")})):
        with pytest.raises(AdapterUnavailable) as refused:
            find("package://seen_description/meshes/base.stl", NAMED, config)
        assert "assets.paths.seen_description" in (refused.value.remedy or "")


@given(
    st.lists(
        st.sampled_from(["..", ".", "", "meshes", "up", "base.stl", "secret.stl", "~", "*", "\\"]),
        min_size=1,
        max_size=8,
    ).map("/".join)
    | st.text(max_size=40)
)
def test_whatever_is_asked_for_nothing_outside_is_found(disk: Path, rest: str) -> None:
    try:
        found = find(f"package://seen_description/{rest}", NAMED, of(disk))
    except RcpError:
        return
    assert found.is_relative_to(disk / "share" / "seen_description")


@pytest.fixture
async def robot(disk: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Robot]:
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(disk))
    domain = fresh_domain()
    uri = "package://seen_description/meshes/base.stl"
    eyes = Eyes(domain, f'<visual><geometry><mesh filename="{uri}"/></geometry></visual>')
    eyes.start()
    async with robot_of(domain, expose=["/robot_description"]) as found:
        await found.until(lambda: FETCH in found.resources)
        yield found
    eyes.stop()


@pytest.mark.anyio
async def test_meshes_come_from_the_package_that_ament_knows(robot: Robot) -> None:
    asset = await robot.execute(FETCH, {"uri": "package://seen_description/meshes/base.stl"})
    assert asset.media_type == "model/stl"
    assert asset.data == b"solid of seen_description"
    with pytest.raises(InvalidValue, match="does not refer to the package 'other'"):
        await robot.execute(FETCH, {"uri": "package://other/meshes/base.stl"})
