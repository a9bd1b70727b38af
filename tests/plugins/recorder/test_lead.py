"""The last samples before a moment fit into a page, and into memory."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

from mcap.writer import Writer

from rcp_recordings.lead import Lead, last_before
from rcp_recordings.names import KIND, PATH, SAMPLE
from rcp_recordings.reading import open_recordings

KIB = 1024


def written(folder: Path, samples: Iterable[tuple[str, int]]) -> Path:
    """Write samples, one a nanosecond, each with its resource and size."""
    file = folder / "one.mcap"
    with file.open("wb") as out:
        writer, channels = Writer(out, chunk_size=64 * KIB), dict[str, int]()
        writer.start()
        for time, (path, size) in enumerate(samples, 1):
            if path not in channels:
                facts = {PATH: path, KIND: SAMPLE}
                channels[path] = writer.register_channel(path, "json", 0, facts)
            writer.add_message(channels[path], time, time.to_bytes(4) * (size // 4), time, time)
        writer.finish()
    return file


def read(file: Path, count: int, size: int) -> Lead:
    with ExitStack() as stack:
        found = list(open_recordings([(file, None)], stack))
        return last_before(found, 2**62, count, size)


def told(lead: Lead) -> list[tuple[str, int]]:
    return [(record.track.facts[PATH], record.log_time) for record in lead.records]


def test_one_that_is_too_long_leaves_the_others_their_room(tmp_path: Path) -> None:
    samples = [("/text", 8), ("/camera", 80), ("/speed", 8), ("/camera", 8 * KIB), ("/mode", 8)]
    found = read(written(tmp_path, samples), 2, 4 * KIB)
    # Nothing older of the camera, which would look like the last that was known.
    assert sorted(told(found)) == [("/mode", 5), ("/speed", 3), ("/text", 1)]
    assert found.left_out == {"/camera"}


def test_the_newest_of_each_resource_come_first_and_without_gaps(tmp_path: Path) -> None:
    samples = [("/rare", KIB)] + [(f"/{name}", KIB) for _ in range(300) for name in "ab"]
    found = read(written(tmp_path, samples), 200, 5 * KIB)
    newest = [("/a", 598), ("/a", 600), ("/b", 599), ("/b", 601), ("/rare", 1)]
    assert sorted(told(found)) == newest
    assert found.left_out == {"/a", "/b"}


def test_what_does_not_fit_is_not_held(tmp_path: Path) -> None:
    paths = [f"/camera/{number}" for number in range(16)]
    file = written(tmp_path, [(path, 16 * KIB) for _ in range(50) for path in paths])  # 12.5 MiB
    tracemalloc.start()
    try:
        found = read(file, 200, 512 * KIB)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(found.records) == 32
    assert most < 3 * KIB * KIB
