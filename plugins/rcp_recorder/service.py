"""`/system/recorder`: recordings as each reader may see them, and requests."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import msgspec

from rcp_kernel.access.acl import Rights
from rcp_kernel.clock import iso
from rcp_kernel.errors import Forbidden, InvalidValue, ModeForbids, QueueFull
from rcp_kernel.features import FeatureHost
from rcp_kernel.features.choice import chosen
from rcp_kernel.model import Operation, Pattern
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_recorder.kept import INCIDENT, Kept
from rcp_recorder.mcap_file import OpenFile
from rcp_recorder.messages import RecorderReply, RecorderRequest, RecordingState, StartRequest
from rcp_recorder.recorder import PATH, Recorder
from rcp_recorder.runs import ALWAYS

__all__ = ["RecorderService"]

_READ = int(Operation.READ)
_RUNS = 32  # recordings on request at a time
_KNOWN = 4096  # sets of paths whose visibility is remembered for each set of rights
_Paths = tuple[frozenset[str], frozenset[str]]


class RecorderService:
    """Shows recordings to whoever may read all that is in them.

    That is every path of which one has samples, in any state of the robots. Of other paths, which have
    only commands and events in it, it is enough to see them, as for the list of commands.
    """

    def __init__(self, recorder: Recorder, host: FeatureHost) -> None:
        self._recorder = recorder
        self._host = host
        self._seen: WeakKeyDictionary[Rights, dict[_Paths, bool]] = WeakKeyDictionary()

    def forget(self) -> None:
        """Look at rights again."""
        self._seen.clear()

    def view(self, session: Session) -> Iterator[dict[str, Any] | None]:
        """List recordings by the names of their files."""
        return self.pages(session, q="", after="")

    def pages(self, session: Session, /, *, q: str, after: str) -> Iterator[dict[str, Any] | None]:
        """List those with the words `q`, after a file."""
        rights, words = session.rights, q.lower().split()
        writer = self._recorder.writer
        found = {file.path.stem: _being_written(file) for file in writer.open.values()}
        found |= {name: _kept(file) for name, file in writer.catalogue.files.items()}
        for name in sorted(name for name in found if name > after):
            shown = found[name]
            if (
                shown is not None
                and self.shows(rights, shown.tenant, shown.paths)
                and shown.matches(words)
            ):
                yield msgspec.to_builtins(shown.state())
            yield None

    def execute(self, session: Session, wanted: RecorderRequest, *, dry_run: bool) -> RecorderReply:
        """Start, stop, pin or unpin."""
        chosen(wanted, PATH)
        if wanted.start is not None:
            return self._start(session, wanted.start, dry_run=dry_run)
        if wanted.stop is not None:
            return self._stop(session, wanted.stop, dry_run=dry_run)
        return self._pin(session, wanted.pin or wanted.unpin or "", wanted, dry_run=dry_run)

    def _start(self, session: Session, wanted: StartRequest, *, dry_run: bool) -> RecorderReply:
        recorder = self._recorder
        if wanted.name in (ALWAYS, INCIDENT) or wanted.name in recorder.runs:
            raise ModeForbids(
                f"there is a recording '{wanted.name}' already",
                path=PATH,
                remedy="Choose another name, or stop it first.",
            )
        if len(recorder.runs) >= _RUNS:
            raise QueueFull(
                f"{_RUNS} recordings are running", path=PATH, remedy="Stop one of them first."
            )
        patterns = [Pattern(text, session.tenant) for text in wanted.paths]
        entries = list(self._readable(session, patterns))
        if not entries:
            raise Forbidden(
                "nothing that matches the paths may be read",
                path=PATH,
                remedy="Name resources that you may read; `discover` lists them.",
            )
        if not dry_run:
            run = recorder.start(wanted.name, patterns, entries)
            if wanted.seconds is not None:
                run.end_after(wanted.seconds, lambda: recorder.stop(wanted.name))
            self.note(session, "start", wanted.name, run.paths)
        return RecorderReply("started", wanted.name, len(entries))

    def _readable(self, session: Session, patterns: list[Pattern]) -> Iterator[Entry]:
        """Iterate over the resources that match and that a session may read in any state."""
        rights, entries = session.rights, self._host.robots.entries
        for path, entry in entries.items():
            if entry.tenant is None or not any(pattern.matches(path) for pattern in patterns):
                continue
            mask = rights.mask(path)
            if mask & _READ if entry.operations & _READ else mask:
                yield entry

    def _stop(self, session: Session, name: str, *, dry_run: bool) -> RecorderReply:
        run = self._recorder.runs.get(name)
        if run is None or not self._host.visibility.sees_all(
            session.rights, run.paths, Operation.READ
        ):
            raise InvalidValue(
                f"there is no recording '{name}'",
                path=PATH,
                remedy=f"Read {PATH}: it lists those that run.",
            )
        if name == ALWAYS:
            raise ModeForbids(
                "the configuration records this always",
                path=PATH,
                remedy="Change `paths` in [features.recorder].",
            )
        if not dry_run:
            paths = run.paths
            self._recorder.stop(name)
            self.note(session, "stop", name, paths)
        return RecorderReply("stopped", name)

    def _pin(
        self, session: Session, file: str, wanted: RecorderRequest, *, dry_run: bool
    ) -> RecorderReply:
        kept = self._recorder.writer.catalogue.files.get(file)
        if kept is None or not self.shows(session.rights, kept.tenant, (kept.samples, kept.others)):
            raise InvalidValue(
                f"there is no file {file!r:.80}",
                path=PATH,
                remedy=f"Read {PATH}: `path` of an item is the name of a file.",
            )
        pinned = wanted.pin is not None
        if not dry_run:
            self._recorder.writer.pin(file, pinned=pinned)
            self.note(session, "pin" if pinned else "unpin", file, kept.samples | kept.others)
        return RecorderReply("pinned" if pinned else "unpinned", file)

    def is_being_written(self, session: Session, name: str) -> bool:
        """Return whether an open file that a session may see has a name."""
        for file in self._recorder.writer.open.values():
            written = file.progress
            if file.path.stem == name and written is not None:
                paths = written.samples, written.others
                return self.shows(session.rights, file.stream.tenant, paths)
        return False

    def note(self, session: Session, do: str, name: str, touches: Iterable[str]) -> None:
        """Put what somebody does with a recording on record."""
        self._host.note(
            "recording",
            principal=session.principal,
            session=session,
            path=PATH,
            touches=touches,
            do=do,
            name=name,
        )

    def shows(self, rights: Rights, tenant: str, paths: _Paths) -> bool:
        """Return whether one may see a file of a tenant.

        One that has nothing but what is told of robots is for whoever may use the recorder there.
        """
        if any(paths):
            return self.sees(rights, paths)
        places = rights.places(PATH, Operation.READ)
        return "*" in places or tenant in places

    def sees(self, rights: Rights, paths: _Paths) -> bool:
        """Return whether one may see samples and other messages of some paths."""
        seen = self._seen.setdefault(rights, {})
        known = seen.get(paths)
        if known is None:
            if len(seen) >= _KNOWN:
                seen.clear()
            samples, others = paths
            known = seen[paths] = all(self.mask(rights, path) & _READ for path in samples) and all(
                self.mask(rights, path) for path in others
            )
        return known

    def mask(self, rights: Rights, path: str) -> int:
        """Return the operations allowed on a path in any state of the robots; it may be gone."""
        exists = path in self._host.robots.entries
        return rights.mask(path) if exists else rights.compute_mask(path)


class _Shown(NamedTuple):
    """A file that may be shown; what its item has is made only then."""

    tenant: str
    paths: _Paths
    words: tuple[str | None, ...]
    state: Callable[[], RecordingState]

    def matches(self, words: list[str]) -> bool:
        """Return whether all words occur."""
        text = " ".join(filter(None, self.words)).lower() if words else ""
        return all(word in text for word in words)


def _being_written(file: OpenFile) -> _Shown | None:
    """Describe a file that is being written; None before its first flush."""
    written, stream = file.progress, file.stream
    if written is None:
        return None
    reason, robot, at = (stream.facts.get(name) for name in ("reason", "robot", "at"))

    def state() -> RecordingState:
        return RecordingState(
            path=file.path.stem,
            name=stream.name,
            tenant=stream.tenant,
            state="recording",
            start=iso(written.start),
            bytes=written.bytes,
            messages=written.messages,
            paths=tuple(sorted(written.samples | written.others)),
            reason=reason,
            robot=robot,
            at=at,
            link=_link(robot, at),
        )

    words = (file.path.stem, reason, robot)
    return _Shown(stream.tenant, (written.samples, written.others), words, state)


def _kept(file: Kept) -> _Shown:
    def state() -> RecordingState:
        return RecordingState(
            path=file.file,
            name=file.name,
            tenant=file.tenant,
            state="kept",
            start=iso(file.start),
            end=iso(file.end),
            bytes=file.bytes,
            messages=file.messages,
            paths=tuple(sorted(file.samples | file.others)),
            pinned=file.pinned,
            recovered=file.recovered,
            reason=file.reason,
            robot=file.robot,
            at=file.at,
            link=_link(file.robot, file.at),
        )

    words = (file.file, file.reason, file.robot)
    return _Shown(file.tenant, (file.samples, file.others), words, state)


def _link(robot: str | None, at: str | None) -> str | None:
    """Return the address of an incident's moment, relative to that of the dashboard."""
    return None if robot is None or at is None else f"#/log?at={at}&robot={robot}"
