"""Recordings as files to download, for whoever may see them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Mapping
from functools import partial
from pathlib import Path
from typing import IO, Any

from rcp_kernel.errors import InvalidValue, PreconditionFailed, UnknownPath
from rcp_kernel.sessions.session import Session
from rcp_kernel.values import Encoding
from rcp_recorder.catalogue import Catalogue
from rcp_recorder.history import History
from rcp_recorder.kept import Kept
from rcp_recorder.service import RecorderService
from rcp_recordings.query import Query
from rcp_web.downloads import Download, HistoryPage

__all__ = ["Downloads", "whole"]

_PIECE = 256 * 1024


class Downloads:
    """The service `recorder.recordings`: files and history, over HTTP."""

    def __init__(self, catalogue: Catalogue, service: RecorderService, history: History) -> None:
        self._catalogue = catalogue
        self._service = service
        self._history = history

    async def page(
        self, session: Session, wanted: Mapping[str, Any], encoding: Encoding
    ) -> HistoryPage:
        """Return a page of history."""
        return await self._history.page(session, wanted, encoding)

    async def table(self, session: Session, wanted: Mapping[str, Any], format_: str) -> Download:
        """Return history in another format."""
        return await self._history.table(session, wanted, format_)

    async def file(self, session: Session, name: str, format_: str) -> Download:
        """Return a recording; a file that is being written has to be complete first."""
        kept = self._kept(session, name)
        path = self._catalogue.folder / name
        if format_ == "mcap":
            self._service.note(session, "download", name, kept.samples | kept.others)
            return whole(path, kept.bytes)
        query = Query(files=((str(path), None),), paths=kept.samples, name=name, format="ros2")
        if format_ == "ros2":
            self._service.note(session, "download", name, kept.samples | kept.others)
            return self._history.copy(query, f"{name.removesuffix('.mcap')}_0.mcap")
        if format_ == "yaml":
            return await asyncio.to_thread(_metadata, path, query)
        raise InvalidValue(f"there is no format {format_!r:.40}", remedy="Use mcap, ros2 or yaml.")

    def _kept(self, session: Session, name: str) -> Kept:
        kept = self._catalogue.files.get(name)
        if kept is not None and self._service.shows(
            session.rights, kept.tenant, (kept.samples, kept.others)
        ):
            return kept
        if kept is None and self._service.is_being_written(session, name):
            raise PreconditionFailed(
                f"{name} is still being written",
                remedy="Stop the recording first, or read a part of it with `from` and `to`.",
            )
        raise UnknownPath(
            f"there is no recording {name[:100]!r}",
            remedy="Read /system/recorder: `path` of an item is the name of a file.",
        )


def whole(path: Path, size: int) -> Download:
    """Return a file of `size` bytes as it is."""

    def pieces(start: int, stop: int | None) -> AsyncIterator[bytes]:
        return _parts(path, start, size if stop is None else stop)

    return Download(name=path.name, media="application/octet-stream", pieces=pieces, size=size)


async def _parts(path: Path, start: int, stop: int) -> AsyncGenerator[bytes]:
    """Read a file on threads; it stays readable if it is deleted meanwhile."""
    loop = asyncio.get_running_loop()
    opening: asyncio.Future[IO[bytes]] = loop.run_in_executor(None, path.open, "rb")
    try:
        file = await asyncio.shield(opening)
        file.seek(start)
        while start < stop:
            piece = await asyncio.to_thread(file.read, min(_PIECE, stop - start))
            if not piece:
                return
            start += len(piece)
            yield piece
    finally:
        opening.add_done_callback(partial(_close, loop))


def _close(loop: asyncio.AbstractEventLoop, opening: asyncio.Future[IO[bytes]]) -> None:
    """Close a file on a thread: what was cut off may still be reading, and closing waits for that."""
    if not opening.cancelled() and opening.exception() is None:
        loop.run_in_executor(None, opening.result().close)


def _metadata(path: Path, query: Query) -> Download:
    from mcap.reader import SeekingReader

    from rcp_recordings.copies import bag_metadata, ros_tracks
    from rcp_recordings.reading import Recording

    with path.open("rb") as file:
        summary = SeekingReader(file).get_summary()
        counts = (
            {}
            if summary is None or summary.statistics is None
            else summary.statistics.channel_message_counts
        )
        recording = Recording(file, None)
        if not list(ros_tracks(recording.tracks, query)):
            raise InvalidValue(
                f"{path.name} has no ROS messages", remedy="Download it as it is: format=mcap."
            )
        data = bag_metadata(recording, query, counts).encode()

    async def one(start: int, stop: int | None) -> AsyncGenerator[bytes]:
        yield data[start:stop]

    return Download(name="metadata.yaml", media="application/yaml", pieces=one, size=len(data))
