"""Build what is released into `dist/`, from a clean tree: nothing is uploaded.

    python packaging/build.py [--partial] [wheels] [sdist] [npm] [deb] [container] [sbom] [docs]

Without names, everything, into an empty folder. Where the container's base is missing, the rest is built all the same, and the exit code is 1 unless `--partial` is
given; a machine without a builder of containers builds none. Files are the same for the same commit, Python and constraints: times are those of the commit.
`SHA256SUMS` lists them.
"""

from __future__ import annotations

import argparse
import base64
import gzip
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[1]
DIST = ROOT / "dist"
HOME = "opt/rcp-gateway"
EXTRAS = "a2a,can,conditions,console,dashboard,fast,fleet,jwt,mavlink,mcp,recorder,tls,tracing"
"""What packages for people bring; MuJoCo and ROS 2 are large, or come from elsewhere."""
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
_CONTAINERFILE = "packaging/container/Containerfile"
_BUILDERS = ("podman", "buildah", "docker")
_PULL = 900.0  # s
_LONGEST = 3600.0  # s that any program may take


def run(*command: str | Path, folder: Path = ROOT, **environment: str) -> str:
    """Run a program in the tree, and return what it prints."""
    done = subprocess.run(  # noqa: S603 - programs of this script
        [str(part) for part in command],
        cwd=folder,
        env={**os.environ, "SOURCE_DATE_EPOCH": _epoch(), **environment},
        check=True,
        stdout=subprocess.PIPE,
        text=True,
        timeout=_LONGEST,
    )
    return done.stdout


def _epoch() -> str:
    """Return the time of the commit, for files that are the same every time."""
    if (given := os.environ.get("SOURCE_DATE_EPOCH")) is not None:
        return given
    done = subprocess.run(
        ["git", "log", "-1", "--format=%ct"],  # noqa: S607
        cwd=ROOT,
        check=False,
        capture_output=True,
        text=True,
    )
    return done.stdout.strip() or "1735689600"


def wheels() -> None:
    """Build the two wheels, with the dashboard's pages."""
    pip = (sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", DIST)
    run(*pip, "clients/python", ".")
    run(sys.executable, ".ci/wheel.py", DIST)


def sdist() -> None:
    """Pack the sources, and build a wheel of them alone."""
    for folder in (ROOT, ROOT / "clients" / "python"):
        build = (sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", DIST)
        run(*build, folder=folder)
    with TemporaryDirectory() as scratch:
        pip = (sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", scratch)
        run(*pip, DIST / f"rcp_gateway-{VERSION}.tar.gz", RCP_DASHBOARD="off")
        run(*pip, DIST / f"rcp_client-{VERSION}.tar.gz")


def npm() -> None:
    """Pack the TypeScript client, compiled."""
    folder = ROOT / "clients" / "typescript"
    with TemporaryDirectory() as scratch:
        copy = Path(scratch) / "typescript"
        shutil.copytree(folder, copy, ignore=shutil.ignore_patterns("node_modules", "dist"))
        shutil.copy(ROOT / "LICENSE", copy)
        run(
            "npm",
            "--prefix",
            copy,
            "install",
            "--silent",
            "--no-audit",
            "--no-fund",
            "--no-package-lock",
        )
        run("npm", "pack", copy, "--silent", "--pack-destination", DIST)


def deb() -> None:
    """Pack a virtual environment, programs and a unit for Debian; the Python is that of the system."""
    _need_wheels("deb")
    python = os.environ.get("DEB_PYTHON", "/usr/bin/python3")
    version = run(python, "-c", "import sys; print('%d.%d' % sys.version_info[:2])").strip()
    major, minor = map(int, version.split("."))
    with TemporaryDirectory() as scratch:
        tree = Path(scratch) / "tree"
        home = tree / HOME
        run(python, "-m", "venv", "--without-pip", home)
        pip = (sys.executable, "-m", "pip", "--python", home / "bin/python", "install", "-q")
        own = (f"rcp-gateway[{EXTRAS}]=={VERSION}", f"rcp-client=={VERSION}")
        # Never those of an index, where anybody may have taken the name.
        run(*pip, "--no-compile", "--no-index", "--no-deps", "--find-links", DIST, *own)
        run(*pip, "--no-compile", "-c", "constraints.txt", *own)
        _relocate(home, tree)
        _add_files(tree)
        size = sum(path.stat().st_size for path in tree.rglob("*") if path.is_file()) // 1024
        facts = {
            "version": VERSION,
            "architecture": run("dpkg", "--print-architecture").strip(),
            "size": str(size),
            "python": version,
            "after": f"{major}.{minor + 1}",
        }
        control = tree / "DEBIAN"
        control.mkdir()
        for source in (ROOT / "packaging" / "debian").iterdir():
            if source.name == "control.in":
                (control / "control").write_text(_filled(source.read_text(), facts))
            else:
                shutil.copy(source, control)
        run("dpkg-deb", "--root-owner-group", "-Zzstd", "--build", tree, DIST)


def _relocate(home: Path, tree: Path) -> None:
    """Write the path at which the environment will be into its programs, and their hashes into the lists."""
    hashes: dict[str, str] = {}
    for path in (*(home / "bin").iterdir(), home / "pyvenv.cfg"):
        if path.is_file() and not path.is_symlink():
            data = path.read_bytes().replace(str(tree).encode(), b"")
            path.write_bytes(data)
            digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=")
            hashes[f"../../../bin/{path.name}"] = f"sha256={digest.decode()},{len(data)}"
    for record in home.glob("lib/*/site-packages/*.dist-info/RECORD"):
        rows = [row.split(",", 1) for row in record.read_text(encoding="utf-8").splitlines()]
        lines = [f"{name},{hashes.get(name, rest)}\n" for name, rest in rows]
        record.write_text("".join(lines), encoding="utf-8")


def _add_files(tree: Path) -> None:
    for name in ("rcpd", "rcpctl"):
        link = tree / "usr/bin" / name
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(f"/{HOME}/bin/{name}")
    unit = tree / "lib/systemd/system/rcp-gateway.service"
    unit.parent.mkdir(parents=True)
    template = (ROOT / "rcpd/templates/rcp-gateway.service.in").read_text(encoding="utf-8")
    facts = {
        "rcpd": f"/{HOME}/bin/rcpd",
        "config": "/etc/rcp/rcp.toml",
        "secrets": "/etc/rcp/secrets.env",
        "home": "HOME=/var/lib/rcp",
        "state": "-/var/lib/rcp",
        "user": "rcp",
        "homes": "true",
        "devices": "false",  # robots on serial ports, cameras
    }
    unit.write_text(_filled(template, facts), encoding="utf-8")
    completion = tree / "usr/share/bash-completion/completions/rcpctl"
    completion.parent.mkdir(parents=True)
    completion.write_text('eval "$(rcpctl completion bash)"\n')
    doc = tree / "usr/share/doc/rcp-gateway"
    doc.mkdir(parents=True)
    shutil.copy(ROOT / "LICENSE", doc / "copyright")
    for path in tree.rglob("*"):  # whatever the umask is here
        if not path.is_symlink():
            path.chmod(0o755 if path.is_dir() or path.stat().st_mode & 0o100 else 0o644)


def _filled(text: str, facts: dict[str, str]) -> str:
    return re.sub(r"@([a-z]+)@", lambda mark: facts[mark[1]], text)


def _need_wheels(step: str) -> None:
    if len([*DIST.glob(f"rcp_*-{VERSION}-py3-none-any.whl")]) < 2:
        raise SystemExit(f"{step}: no wheels in {DIST}: python packaging/build.py wheels {step}")


def _builder() -> str | None:
    return next((name for name in _BUILDERS if shutil.which(name)), None)


def _no_base(builder: str) -> str | None:
    """Return why there is no base to build an image on; None: there is one."""
    if os.environ.get("RCP_BASE"):
        return None
    base = re.search(r"^ARG BASE=(\S+)", (ROOT / _CONTAINERFILE).read_text(), re.MULTILINE)
    assert base is not None
    # The registry may not be reached, or allow no more today, for what is here already.
    inspect = ("inspect", "--type", "image") if builder == "buildah" else ("image", "inspect")
    if _fault_of(builder, *inspect, base[1]) is None:
        return None
    reason = _fault_of(builder, "pull", "--quiet", base[1])
    if reason is None:
        return None
    return (
        f"{base[1]} cannot be pulled ({reason}); with RCP_BASE=NAME another base is taken, such as "
        "one of Debian's packages, which packaging/container/base makes"
    )


def _fault_of(*command: str) -> str | None:
    """Run a program; return the last line of why it failed."""
    try:
        done = subprocess.run(  # noqa: S603
            command, check=False, capture_output=True, text=True, timeout=_PULL
        )
    except subprocess.TimeoutExpired:
        return f"no answer within {_PULL:g} s"
    if done.returncode == 0:
        return None
    return (done.stderr.strip().splitlines() or ["unknown"])[-1]


def container() -> None:
    """Build the image with whatever builder there is, and write it as an OCI archive."""
    builder = _builder()
    if builder is None:
        raise SystemExit(f"container: none of {', '.join(_BUILDERS)} is installed")
    _need_wheels("container")
    base = os.environ.get("RCP_BASE")
    extra = os.environ.get("RCP_BUILD_ARGS", "").split()
    own = [f"VERSION={VERSION}", *([f"BASE={base}"] if base else [])]
    arguments = [*(word for one in own for word in ("--build-arg", one)), *extra]
    tag = f"rcp-gateway:{VERSION}"
    verb = ("bud",) if builder == "buildah" else ("build",)
    run(builder, *verb, *arguments, "-f", _CONTAINERFILE, "-t", tag, ".")
    if builder != "docker":
        (DIST / f"rcp-gateway-{VERSION}.oci.tar").unlink(missing_ok=True)
        # The least work of gzip, which every program reads, for a tenth more bytes.
        level = ("--compression-format", "gzip", "--compression-level", "1")
        run(builder, "push", *level, tag, f"oci-archive:{DIST}/rcp-gateway-{VERSION}.oci.tar")


def sbom() -> None:
    """List what a wheel needs with versions and licences, as CycloneDX 1.5."""
    from importlib.metadata import distribution, distributions

    pins = re.findall(r"^([\w.-]+)==(\S+)$", (ROOT / "constraints.txt").read_text(), re.MULTILINE)
    installed = {re.sub(r"[-_.]+", "-", one.name).lower() for one in distributions()}
    components = []
    for name, version in pins:
        licence = None
        if name in installed:
            found = distribution(name).metadata
            licence = found.get("License-Expression") or found.get("License")
        component = {
            "type": "library",
            "bom-ref": f"pkg:pypi/{name}@{version}",
            "name": name,
            "version": version,
            "purl": f"pkg:pypi/{name}@{version}",
        }
        if licence and len(licence) < 80:
            component["licenses"] = [{"license": {"name": licence.strip()}}]
        components.append(component)
    document = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {
            "component": {"type": "application", "name": "rcp-gateway", "version": VERSION}
        },
        "components": components,
    }
    text = json.dumps(document, indent=2, sort_keys=True) + "\n"
    (DIST / f"rcp-gateway-{VERSION}.cdx.json").write_text(text, encoding="utf-8")


def docs() -> None:
    """Pack the documentation as a site; a link that leads nowhere is a failure."""
    run(sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", NO_MKDOCS_2_WARNING="1")

    def plain(entry: tarfile.TarInfo) -> tarfile.TarInfo:
        entry.mtime, entry.uid, entry.gid, entry.uname, entry.gname = int(_epoch()), 0, 0, "", ""
        entry.mode = 0o755 if entry.isdir() else 0o644
        return entry

    site = ROOT / "build" / "site"
    for path in site.glob(
        "sitemap.xml*"
    ):  # with the address of no server, and the day of the build
        path.unlink()
    with (
        (DIST / f"rcp-gateway-docs-{VERSION}.tar.gz").open("wb") as out,
        gzip.GzipFile("", "wb", fileobj=out, mtime=int(_epoch())) as packed,
        tarfile.open(fileobj=packed, mode="w") as archive,
    ):
        archive.add(site, "site", filter=plain)


def sums() -> None:
    """List the files with their hashes."""
    lines = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n"
        for path in sorted(DIST.iterdir())
        if path.name != "SHA256SUMS"
    ]
    (DIST / "SHA256SUMS").write_text("".join(lines), encoding="utf-8")


STEPS: dict[str, Callable[[], None]] = {
    "wheels": wheels,
    "sdist": sdist,
    "npm": npm,
    "deb": deb,
    "container": container,
    "sbom": sbom,
    "docs": docs,
}


def main() -> None:
    """Build what is named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("steps", nargs="*", metavar="STEP", help=", ".join(STEPS))
    parser.add_argument("--partial", action="store_true", help="a release may lack its container")
    given = parser.parse_args()
    steps, reason = list[str](given.steps), None
    if unknown := [step for step in steps if step not in STEPS]:
        parser.error(f"unknown: {', '.join(unknown)}")
    if not steps:
        shutil.rmtree(DIST, ignore_errors=True)
        builder = _builder()
        reason = None if builder is None else _no_base(builder)
        steps = [step for step in STEPS if step != "container" or (builder and not reason)]
        if "container" not in steps:
            why = reason or f"none of {', '.join(_BUILDERS)} is installed"
            print(f"=== no container: {why}", flush=True)
    DIST.mkdir(exist_ok=True)
    for step in steps:
        print(f"=== {step}", flush=True)
        STEPS[step]()
    sums()
    if reason is not None and not given.partial:
        raise SystemExit("this release has no container: --partial allows that")


if __name__ == "__main__":
    main()
