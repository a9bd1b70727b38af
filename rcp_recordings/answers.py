"""From a query to its answer."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import IO

from rcp_recordings.columns import Column, columns
from rcp_recordings.copies import copied, is_wanted, write_copy
from rcp_recordings.lead import Lead, last_before
from rcp_recordings.names import KIND, PATH, SAMPLE
from rcp_recordings.pages import as_page
from rcp_recordings.query import Query
from rcp_recordings.reading import Recording, Track, messages, open_recordings
from rcp_recordings.rows import intervals, samples
from rcp_recordings.tables import as_arrow, as_csv
from rcp_recordings.values import schema_of

__all__ = ["answer"]


def answer(
    query: Query, files: Iterable[tuple[Path, int | None]], stack: ExitStack, out: IO[bytes]
) -> None:
    """Write the answer to a query.

    :raises ImportError: it needs pyarrow.
    :raises ValueError: the recordings do not have what is wanted.
    """
    copies = query.format in ("mcap", "ros2")

    def wanted(track: Track) -> bool:
        if copies:
            return is_wanted(track, query)
        return track.facts.get(KIND) == SAMPLE and track.facts.get(PATH) in query.paths

    recordings: list[Recording] = []
    for recording in open_recordings(files, stack):
        recording.keep(wanted, 0 if query.before else query.start, query.end)
        recordings.append(recording)
    if copies:
        write_copy(copied(recordings, query), query, out)
        return
    records = messages(recordings, wanted, query.start, query.end)
    summary = query.every is not None and not query.thin
    rows = (
        intervals(records, query.fields, query.every)
        if query.every is not None and not query.thin
        else samples(records, query.fields, query.every)
    )
    if query.format == "json":
        lead = _lead(recordings, wanted, query, stack)
        begin = samples(lead.records, query.fields)
        out.write(as_page(rows, query, begin, lead.left_out))
        return
    table = _columns(recordings, wanted, query)
    if query.format == "csv":
        as_csv(rows, table, summary=summary, out=out)
    else:
        as_arrow(rows, table, summary=summary, parquet=query.format == "parquet", out=out)


def _lead(
    recordings: list[Recording], wanted: Callable[[Track], bool], query: Query, stack: ExitStack
) -> Lead:
    """Return the last samples before the first moment."""
    if not query.before:
        return Lead([], set())
    earlier = open_recordings([(Path(path), size) for path, size in query.earlier], stack)
    for recording in earlier:
        recording.keep(wanted, 0, query.start)
        recordings = [*recordings, recording]
    return last_before(recordings, query.start, query.before, query.room)


def _columns(
    recordings: list[Recording], wanted: Callable[[Track], bool], query: Query
) -> list[Column]:
    """Return the columns of the newest schema: an earlier one may differ."""
    found: list[Column] = []
    for recording in recordings:
        for track in recording.tracks.values():
            if wanted(track):
                found = columns(schema_of(track), query.fields)
    return found
