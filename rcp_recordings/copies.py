"""Parts of recordings as recordings of their own: as they are, or as a bag of ROS 2."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import IO

from mcap.writer import Writer

from rcp_recordings.names import (
    COMMAND,
    ESTOP,
    EVENT,
    FACTS,
    KIND,
    NATIVE,
    PATH,
    QOS,
    SAMPLE,
    TOPIC,
)
from rcp_recordings.query import Query
from rcp_recordings.reading import Record, Recording, Track, messages

__all__ = ["bag_metadata", "bag_name", "copied", "is_wanted", "ros_tracks", "write_copy"]

_LIBRARY = "rcp-gateway"


def is_wanted(track: Track, query: Query) -> bool:
    """Return whether a copy has a channel."""
    path, kind = track.facts.get(PATH), track.facts.get(KIND)
    if kind in (SAMPLE, NATIVE):
        return path in query.paths
    if kind in (COMMAND, EVENT):
        return path in query.others
    return kind == ESTOP and query.tenant


def copied(recordings: list[Recording], query: Query) -> Iterator[Record]:
    """Iterate over the messages of a copy.

    :raises ValueError: it is to be a bag, and there are no ROS messages.
    """
    if query.format == "ros2":
        chosen = {
            id(track.channel) for one in recordings for track in ros_tracks(one.tracks, query)
        }
        if not chosen:
            raise ValueError("no ROS messages were recorded there")
        return messages(
            recordings, lambda track: id(track.channel) in chosen, query.start, query.end
        )
    return messages(recordings, lambda track: is_wanted(track, query), query.start, query.end)


def ros_tracks(tracks: Mapping[int, Track], query: Query) -> Iterable[Track]:
    """Return the channels of ROS topics, each topic once: several paths may be of one."""
    found: dict[str, Track] = {}
    for _, track in sorted(tracks.items()):
        topic = track.facts.get(TOPIC)
        if topic and track.channel.message_encoding == "cdr" and is_wanted(track, query):
            found.setdefault(topic, track)
    return found.values()


def write_copy(records: Iterable[Record], query: Query, out: IO[bytes]) -> None:
    """Write a copy; a bag has the topics and the profile of ROS 2."""
    ros = query.format == "ros2"
    writer = Writer(out)
    writer.start(profile="ros2" if ros else "", library=_LIBRARY)
    if not ros:
        writer.add_metadata(FACTS, {"recording": query.name or "copy"})
    numbers: dict[int, int] = {}
    topics: dict[tuple[str, str, str, str], int] = {}
    schemas: dict[tuple[str, str, bytes], int] = {}
    for record in records:
        number = numbers.get(id(record.track.channel))
        if number is None:
            number = _register(writer, record.track, topics, schemas, ros=ros)
            numbers[id(record.track.channel)] = number
        writer.add_message(number, record.log_time, record.data, record.publish_time, record.seq)
    writer.finish()


def _register(
    writer: Writer,
    track: Track,
    topics: dict[tuple[str, str, str, str], int],
    schemas: dict[tuple[str, str, bytes], int],
    *,
    ros: bool,
) -> int:
    channel, schema = track
    topic = channel.metadata[TOPIC] if ros else channel.topic
    name, encoding, data = (
        ("", "", b"") if schema is None else (schema.name, schema.encoding, schema.data)
    )
    same = (topic, channel.message_encoding, name, data.decode("latin-1"))
    if same in topics:  # of another file
        return topics[same]
    number = schemas.get((name, encoding, data))
    if number is None:
        number = schemas[name, encoding, data] = writer.register_schema(name, encoding, data)
    facts = {QOS: channel.metadata.get(QOS, "")} if ros else channel.metadata
    topics[same] = made = writer.register_channel(topic, channel.message_encoding, number, facts)
    return made


def bag_name(recording: str) -> str:
    """Return the name of the folder of a recording's bag, which its file begins with."""
    return recording.removesuffix(".mcap")


def bag_metadata(recording: Recording, query: Query, counts: Mapping[int, int]) -> str:
    """Return the text of a bag's `metadata.yaml`, in a version that every distribution reads."""
    tracks = list(ros_tracks(recording.tracks, query))
    total = sum(counts.get(track.channel.id, 0) for track in tracks)
    first, last = recording.span({track.channel.id: track for track in tracks})
    start = f"nanoseconds_since_epoch: {first}"
    duration = f"nanoseconds: {last - first}"
    file = f"{bag_name(query.name)}_0.mcap"
    lines = [
        "rosbag2_bagfile_information:",
        "  version: 5",
        "  storage_identifier: mcap",
        f"  duration:\n    {duration}",
        f"  starting_time:\n    {start}",
        f"  message_count: {total}",
        "  topics_with_message_count:" if tracks else "  topics_with_message_count: []",
    ]
    for track in tracks:
        qos = track.facts.get(QOS, "").replace("\n", "\\n")
        lines += [
            "    - topic_metadata:",
            f"        name: {track.facts[TOPIC]}",
            f"        type: {track.schema.name if track.schema else ''}",
            "        serialization_format: cdr",
            f'        offered_qos_profiles: "{qos}"',
            f"      message_count: {counts.get(track.channel.id, 0)}",
        ]
    lines += [
        '  compression_format: ""',
        '  compression_mode: ""',
        f"  relative_file_paths:\n    - {file}",
        f"  files:\n    - path: {file}\n      starting_time:\n        {start}",
        f"      duration:\n        {duration}\n      message_count: {total}",
    ]
    return "\n".join(lines) + "\n"
