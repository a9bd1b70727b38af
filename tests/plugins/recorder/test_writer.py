"""What is written stays readable: when it is cut off, when the disk is full, when space runs out."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from plugins.recorder.files import lines, message, stream
from rcp_recorder import writer as writer_module
from rcp_recorder.catalogue import Catalogue
from rcp_recorder.channels import Message, Stream
from rcp_recorder.config import RecorderConfig
from rcp_recorder.kept import INCIDENT
from rcp_recorder.mcap_file import OpenFile
from rcp_recorder.repair import DAMAGED, repair
from rcp_recorder.writer import Writer
from rcp_recordings.names import ACTIVE

BOUND = 60.0  # s
HERE = Path(__file__).parent


def until(wanted: Callable[[], object], what: str) -> None:
    end = time.monotonic() + BOUND
    while not wanted():
        assert time.monotonic() < end, what
        threading.Event().wait(0.01)


@contextmanager
def writing(
    folder: Path,
    open_file: Callable[[Path, Stream, float], OpenFile] = OpenFile,
    **options: float,
) -> Iterator[Writer]:
    config = RecorderConfig(str(folder), **{"free_mb": 0.0, **options})  # pyright: ignore[reportArgumentType]
    writer = Writer(config, lambda: None, open_file)
    writer.start()
    try:
        yield writer
    finally:
        writer.close()


def complete(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.mcap"))


def killed(folder: Path, after: int) -> tuple[int, int]:
    """Record in a process, kill it after some messages; return the last number and time."""
    recording = [sys.executable, str(HERE / "recording.py"), str(folder)]
    with subprocess.Popen(recording, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for _ in range(after):
            process.stdout.readline()
        os.kill(process.pid, signal.SIGKILL)
        last = [line for line in process.stdout.read().splitlines() if line.count(" ") == 1]
    number, moment = last[-1].split() if last else ("0", "0")
    return int(number), int(moment)


def test_every_message_is_read_by_the_stock_reader(tmp_path: Path) -> None:
    with writing(tmp_path) as writer:
        one = stream()
        for number in range(1, 1001):
            writer.add(one, message(number))
    read = lines(*complete(tmp_path))
    assert [line.value["number"] for line in read] == list(range(1, 1001))
    assert {line.topic for line in read} == {"/tenant/alpha/sensor/pose"}
    assert (read[6].log_time, read[6].publish_time) == (7, 7)


@pytest.mark.parametrize("after", [200, 900, 1500, 2100, 2600])
def test_what_was_flushed_outlives_a_kill(tmp_path: Path, after: int) -> None:
    _, moment = killed(tmp_path, after)
    with writing(tmp_path) as writer:
        until(lambda: writer.catalogue.files or not list(tmp_path.iterdir()), "it is recovered")
        kept = list(writer.catalogue.files.values())
    assert not list(tmp_path.glob(f"*{ACTIVE}"))
    read = lines(*complete(tmp_path))
    assert [line.value["number"] for line in read] == list(range(1, len(read) + 1))
    if after > 2000 and moment:  # it ran for at least a second
        assert kept
        assert kept[0].recovered


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    """A file of several chunks, cut off before its index."""
    active = tmp_path / f"a.mcap{ACTIVE}"
    file = OpenFile(active, stream(), 0.0)
    for number in range(1, 31):
        file.add(message(number))
        if number % 10 == 0:
            file.flush(0.0)
    file.abandon()
    return active


def test_a_file_cut_off_at_any_byte_is_completed(whole: Path) -> None:
    data = whole.read_bytes()
    seen = set()
    for cut in range(0, len(data), 7):
        whole.write_bytes(data[:cut])
        done = repair(whole)
        read = [] if done is None else lines(done)
        assert [line.value["number"] for line in read] == list(range(1, len(read) + 1)), cut
        assert len(read) % 10 == 0
        seen.add(len(read))
        if done is not None:
            done.unlink()
    whole.write_bytes(data)
    assert lines(repair(whole) or whole)[-1].value["number"] == 30
    assert seen >= {0, 10, 20}


def test_a_repair_that_is_cut_off_is_done_again(whole: Path) -> None:
    data = whole.read_bytes()
    done = repair(whole)
    assert done is not None
    repaired = done.read_bytes()
    done.unlink()
    for cut in range(len(data), len(repaired), 11):
        whole.write_bytes(repaired[:cut])
        done = repair(whole)
        assert done is not None
        assert len(lines(done)) == 30
        done.unlink()


def test_a_damaged_chunk_ends_what_is_read(whole: Path) -> None:
    data = bytearray(whole.read_bytes())
    data[len(data) // 2] ^= 0xFF
    whole.write_bytes(data)
    done = repair(whole)
    assert done is not None
    assert len(lines(done)) in (10, 20)


@pytest.mark.parametrize("place", [0.02, 0.4])
def test_a_file_with_damage_before_its_end_is_kept_beside_what_is_read(
    whole: Path, place: float
) -> None:
    """As a power failure leaves it, after which later blocks are there and earlier ones are not."""
    data = bytearray(whole.read_bytes())
    hole = int(len(data) * place)
    data[hole : hole + 64] = bytes(64)
    whole.write_bytes(data)
    with writing(whole.parent) as writer:
        until(lambda: writer._ready, "it is open")  # noqa: SLF001 - there is nothing else to see
        assert len(writer.catalogue.damaged) == 1
    assert Path(f"{whole}{DAMAGED}").read_bytes() == data
    assert [len(lines(file)) for file in complete(whole.parent)] == ([] if place < 0.1 else [10])


def test_no_length_that_is_wrong_keeps_the_recorder_from_recording(whole: Path) -> None:
    data = whole.read_bytes()
    for place in range(len(data) // 3, len(data) // 3 * 2, 3):
        damaged = data[:place] + b"\xff" * 8 + data[place + 8 :]
        whole.write_bytes(damaged)
        repair(whole)
        for file in whole.parent.iterdir():
            file.unlink()


def test_a_file_whose_last_blocks_were_not_written_is_not_damaged(whole: Path) -> None:
    whole.write_bytes(whole.read_bytes() + bytes(1 << 20))
    done = repair(whole)
    assert done is not None
    assert len(lines(done)) == 30
    assert not Path(f"{whole}{DAMAGED}").exists()


def test_a_record_that_was_not_written_to_its_end_is_not_damage(whole: Path) -> None:
    data = whole.read_bytes()
    for cut in range(0, len(data), 3):
        whole.write_bytes(data[:cut])
        done = repair(whole)
        assert not Path(f"{whole}{DAMAGED}").exists(), cut
        if done is not None:
            done.unlink()


@pytest.mark.parametrize("wrong", [1 << 60, 1 << 20])
@pytest.mark.parametrize("chunk", [0, 1, 2])
def test_a_wrong_length_near_the_end_is_damage(whole: Path, chunk: int, wrong: int) -> None:
    data = bytearray(whole.read_bytes())
    at = chunks(bytes(data))[chunk]
    data[at + 1 : at + 9] = wrong.to_bytes(8, "little")
    whole.write_bytes(data)
    done = repair(whole)
    assert (0 if done is None else len(lines(done))) == 10 * chunk
    assert Path(f"{whole}{DAMAGED}").read_bytes() == data


def chunks(data: bytes) -> list[int]:
    """Find where chunks begin."""
    found: list[int] = []
    at = len(MCAP0_MAGIC)
    while at < len(data):
        if data[at] == Opcode.CHUNK:
            found.append(at)
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    return found


@pytest.fixture
def damaged(whole: Path) -> Path:
    """A file of three chunks, of which the second is damaged."""
    data = bytearray(whole.read_bytes())
    at = chunks(bytes(data))[1]
    data[at + 60] ^= 0xFF
    whole.write_bytes(data)
    return whole


class Disk:
    """How much of the disk is free, as a test says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.free = 0
        monkeypatch.setattr("rcp_recorder.catalogue.shutil.disk_usage", lambda _: self)


def test_a_damaged_file_waits_for_room_for_what_can_be_read_of_it(
    damaged: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Disk(monkeypatch)
    disk.free = 1_000_100  # no room for the copy, but for recording
    catalogue = Catalogue(damaged.parent, keep=1e6, free=1e6)
    for _ in range(2):
        catalogue.open()
        catalogue.make_room(0)
        assert list(catalogue.damaged) == [damaged.name]
        assert [path.name for path in damaged.parent.iterdir()] == [damaged.name]
    disk.free = 1_010_000
    catalogue.open()
    assert list(catalogue.damaged) == [f"{damaged.name}{DAMAGED}"]
    assert [len(lines(file)) for file in complete(damaged.parent)] == [10]


def test_a_damaged_file_for_which_the_disk_has_no_room_is_tried_again(
    damaged: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    catalogue = Catalogue(damaged.parent, keep=1e6, free=0)
    with monkeypatch.context() as during:
        during.setattr("rcp_recorder.repair._complete", full)
        catalogue.open()
    assert [path.name for path in damaged.parent.iterdir()] == [damaged.name]
    catalogue.open()
    assert [len(lines(file)) for file in complete(damaged.parent)] == [10]


@pytest.mark.parametrize("pinned", [False, True])
def test_the_oldest_recordings_make_room_for_what_can_be_read_of_a_damaged_one(
    damaged: Path, tmp_path: Path, *, pinned: bool
) -> None:
    filled(tmp_path / "other", "old")
    (old,) = complete(tmp_path / "other")
    old = old.rename(tmp_path / old.name)
    if pinned:
        old.with_name(f"{old.name}.pin").touch()
    catalogue = Catalogue(tmp_path, keep=old.stat().st_size + 100, free=0)
    catalogue.open()
    assert old.exists() == pinned
    assert damaged.exists() == pinned
    catalogue.make_room(0)
    assert not damaged.exists()
    assert (catalogue.damaged_deleted, len(complete(tmp_path))) == ((1, 1) if pinned else (0, 1))


def test_damaged_files_are_deleted_by_their_age_as_others_are(tmp_path: Path) -> None:
    for age, name in enumerate(("always.a", "incident.a", "always.b", "always.c")):
        file = tmp_path / f"{name}.mcap{ACTIVE}{DAMAGED}"
        file.write_bytes(bytes(1000))
        os.utime(file, ns=(age, age))
    catalogue = Catalogue(tmp_path, keep=2500, free=0)
    catalogue.open()
    assert len(catalogue.damaged) == 4
    catalogue.make_room(0)
    assert catalogue.damaged_deleted == 2
    assert {path.name[:10] for path in tmp_path.iterdir()} == {"incident.a", "always.c.m"}
    for file in tmp_path.iterdir():
        file.unlink()  # somebody has moved them away
    catalogue.make_room(0)
    assert not catalogue.damaged


def test_files_roll_by_size_and_each_is_complete(tmp_path: Path) -> None:
    with writing(tmp_path, roll_mb=0.02) as writer:
        one = stream()
        for number in range(1, 9):
            data = f'"{os.urandom(15_000).hex()}"'.encode()
            writer.add(one, message(number)._replace(data=data))
            until(lambda: not writer.waiting, "it is written")
            time_to_flush(writer)
    assert len(complete(tmp_path)) > 1
    assert len(lines(*complete(tmp_path))) == 8


def time_to_flush(writer: Writer) -> None:
    """Wait until everything that was added has reached a file."""
    before = {stream_: file.flushed for stream_, file in writer.open.items()}
    until(
        lambda: (
            any(
                stream_ not in writer.open or writer.open[stream_].flushed > moment
                for stream_, moment in before.items()
            )
            or not before
        ),
        "it is flushed",
    )


def test_files_roll_by_age(tmp_path: Path) -> None:
    with writing(tmp_path, roll_seconds=0.01) as writer:
        one = stream()
        for number in (1, 2, 3):
            writer.add(one, message(number))
            until(lambda n=number: len(writer.catalogue.files) == n, "the file is complete")
    assert [line.value["number"] for line in lines(*complete(tmp_path))] == [1, 2, 3]


def filled(folder: Path, *names: str) -> None:
    """Write a file of about 50 kB for each name, one after the other."""
    for number, name in enumerate(names, 1):
        with writing(folder) as writer:
            data = f'"{os.urandom(25_000).hex()}"'.encode()
            writer.add(stream(name), message(number)._replace(data=data))


def test_the_oldest_leave_first_but_for_pinned_ones_and_incidents(tmp_path: Path) -> None:
    filled(tmp_path, INCIDENT, "pinned", "old", "new", "newest")
    catalogue = Catalogue(tmp_path, keep=1e9, free=0)
    catalogue.open()
    catalogue.pin(next(f for f in catalogue.files if f.startswith("pinned")), pinned=True)
    sizes = {kept.name: kept.bytes for kept in catalogue.files.values()}
    left = Catalogue(tmp_path, keep=sum(sizes.values()) - sizes["old"], free=0)
    left.open()
    left.make_room(0)
    assert {kept.name for kept in left.files.values()} == {INCIDENT, "pinned", "new", "newest"}
    left.make_room(sizes["new"] + sizes["newest"])
    assert {kept.name for kept in left.files.values()} == {INCIDENT, "pinned"}
    assert len(complete(tmp_path)) == 2


def test_pinned_recordings_that_take_all_space_stop_the_recording(tmp_path: Path) -> None:
    filled(tmp_path, "pinned")
    (file,) = complete(tmp_path)
    file.with_name(f"{file.name}.pin").touch()
    with writing(tmp_path, keep_mb=0.001) as writer:
        until(lambda: writer.trouble, "it tells")
        assert "pinned" in (writer.trouble or "")
    assert complete(tmp_path) == [file]


class FullDisk(OpenFile):
    """A file on a disk that is full after some messages, until the test makes room."""

    room = 50

    def add(self, message: Message) -> None:
        if type(self).room <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        type(self).room -= 1
        super().add(message)


def test_a_full_disk_stops_the_recording_until_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer_module, "_RETRY", 0.3)
    monkeypatch.setattr(writer_module, "_FLUSH", 0.0)
    FullDisk.room = 50
    other = tmp_path / "other.txt"
    other.write_text("mine")
    with writing(tmp_path, FullDisk) as writer:
        one = stream()
        for number in range(1, 51):
            writer.add(one, message(number))
        until(lambda: not writer.waiting and writer.open, "it is written")
        time_to_flush(writer)
        writer.add(one, message(51))
        until(lambda: writer.trouble, "it tells")
        assert "No space left" in (writer.trouble or "")
        assert writer.lost >= 1
        FullDisk.room = 1000
        until(lambda: writer.trouble is None, "it goes on")
        assert writer.catalogue.repaired == 1
        writer.add(one, message(52))
    assert [line.value["number"] for line in lines(*complete(tmp_path))] == [*range(1, 51), 52]
    assert other.read_text() == "mine"


@pytest.mark.skipif(sys.platform != "linux", reason="a limit of the system on the size of files")
def test_a_file_that_the_system_lets_grow_no_more_stops_the_recording(tmp_path: Path) -> None:
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000));"
        "sys.path.insert(0, sys.argv[2]);"
        "from recording import record; record(sys.argv[1])"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path), str(HERE)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if "recording_stopped" in line:
                break
        else:
            pytest.fail("it never told")
        assert process.poll() is None, "the process goes on"
        process.kill()
    with writing(tmp_path) as writer:
        until(lambda: writer.catalogue.files, "what was written is recovered")
    read = lines(*complete(tmp_path))
    assert [line.value["number"] for line in read] == list(range(1, len(read) + 1))


def test_a_full_queue_drops_and_counts_and_never_waits(tmp_path: Path) -> None:
    blocked, entered = threading.Event(), threading.Event()

    class Slow(OpenFile):
        def add(self, message: Message) -> None:
            entered.set()
            blocked.wait(BOUND)
            super().add(message)

    with writing(tmp_path, Slow, queue_mb=0.01) as writer:
        one = stream()
        writer.add(one, message(0))
        assert entered.wait(BOUND)
        for number in range(1, 101):
            writer.add(one, message(number, size=100))
        assert writer.dropped > 50
        assert writer.waiting <= 10_000
        blocked.set()
    assert len(lines(*complete(tmp_path))) + writer.dropped == 101


def test_a_clock_set_back_is_counted_and_begins_a_file(tmp_path: Path) -> None:
    second = 10**9
    with writing(tmp_path) as writer:
        one = stream()
        for number, moment in enumerate((100 * second, 101 * second, 50 * second, 51 * second)):
            writer.add(one, message(number, moment))
        until(lambda: not writer.waiting, "it is written")
        assert writer.set_back == 1
    assert sorted(len(lines(file)) for file in complete(tmp_path)) == [2, 2]


def test_files_of_others_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "broken.mcap").write_bytes(b"no recording")
    with writing(tmp_path, keep_mb=0.000001) as writer:
        until(lambda: writer._ready, "it is open")  # noqa: SLF001 - there is nothing else to see
        assert not writer.catalogue.files
    assert (tmp_path / "broken.mcap").exists()
