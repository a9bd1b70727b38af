"""Of a file that is damaged nothing is read that was not written, and nothing is missing untold."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import pytest
from mcap.exceptions import McapError
from mcap.writer import CompressionType, Writer

from plugins.recorder.files import message, stream
from rcp_recorder.mcap_file import OpenFile
from rcp_recordings.reading import Gap, Record, messages, open_recordings, records


class _Read(NamedTuple):
    messages: list[tuple[int, int, bytes]]
    gaps: list[Gap]


def _read(file: Path) -> _Read:
    with ExitStack() as stack:
        found = list(records(open_recordings([(file, None)], stack), lambda _: True))
    return _Read(
        [(one.log_time, one.seq, one.data) for one in found if isinstance(one, Record)],
        [one for one in found if isinstance(one, Gap)],
    )


@pytest.fixture
def ours(tmp_path: Path) -> Path:
    file = OpenFile(tmp_path / "a.mcap.active", stream(), 0.0)
    for number in range(1, 31):
        file.add(message(number))
        if number % 10 == 0:
            file.flush(0.0)
    return file.finish()


@pytest.fixture
def uncompressed(tmp_path: Path) -> Path:
    """One of another program, in which any bit of a value can be another one."""
    path = tmp_path / "b.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=256, compression=CompressionType.NONE)
        writer.start()
        channel = writer.register_channel("/speed", "json", 0)
        for number in range(30):
            writer.add_message(channel, number, b'{"speed": %d}' % number, number, number)
        writer.finish()
    return path


@pytest.mark.parametrize("which", ["ours", "uncompressed"])
def test_a_flipped_bit_changes_no_value_and_hides_none(
    which: str, request: pytest.FixtureRequest
) -> None:
    file: Path = request.getfixturevalue(which)
    data, whole = file.read_bytes(), _read(file)
    assert len(whole.messages) == 30
    refused = gaps = 0
    for place in range(len(data)):
        damaged = bytearray(data)
        damaged[place] ^= 1 << place % 8
        file.write_bytes(damaged)
        try:
            read = _read(file)
        except McapError:
            refused += 1
            continue
        assert set(read.messages) <= set(whole.messages), place
        assert len(read.messages) == 30 or read.gaps, place
        gaps += bool(read.gaps)
    assert refused > 100
    assert gaps > 100


def test_a_value_that_was_changed_ends_what_is_read_with_the_place(uncompressed: Path) -> None:
    data = bytearray(uncompressed.read_bytes())
    place = data.index(b'"speed": 12')
    data[place + 9] ^= 1
    uncompressed.write_bytes(data)
    with ExitStack() as stack:
        found = messages(open_recordings([(uncompressed, None)], stack), lambda _: True)
        read: list[int] = []
        with pytest.raises(McapError, match=r"b\.mcap: the chunk at byte \d+ is damaged: crc"):
            read.extend(one.seq for one in found)
    assert read == list(range(len(read)))
    assert 0 < len(read) <= 12


@pytest.mark.parametrize("which", ["ours", "uncompressed"])
def test_a_file_that_is_cut_off_anywhere_is_refused(
    which: str, request: pytest.FixtureRequest
) -> None:
    file: Path = request.getfixturevalue(which)
    data = file.read_bytes()
    for size in range(len(data)):
        file.write_bytes(data[:size])
        with pytest.raises(McapError, match="the file is cut off, or no recording"):
            _read(file)
