"""ROS logs of every kind as those of `log`: MCAP files, ROS 1 bags (`.bag`), rosbag2 (`.db3`) and its folders.

A `.db3` is a SQLite database with messages as ROS 2 writes them; its `metadata.yaml` is not needed. Of both kinds only
messages of `log.MESSAGE_TYPES` are read, by definitions that do not come from the file.
"""

from __future__ import annotations

import bz2
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from micah_plan.errors import InputError, MissingDependencyError, shown
from micah_plan.files import LARGEST_FILE_BYTES, read_bytes
from micah_plan.recording.ros_mcap import (
    MESSAGE_TYPES,
    Logged,
    Topic,
    decoded,
    definition,
    log_topics,
    read_log,
    unpacked_lz4,
)

_REMEDY = "record it again, or repair it with `rosbag reindex`"
LOGS = (".mcap", ".db3", ".bag")
_COUNTS = (
    "SELECT topics.name, topics.type, COUNT(messages.id) FROM topics "
    "LEFT JOIN messages ON messages.topic_id = topics.id GROUP BY topics.id"
)
_TABLES = (
    "SELECT topics.name, topics.type, messages.timestamp, messages.data FROM messages "
    "JOIN topics ON messages.topic_id = topics.id WHERE topics.serialization_format = 'cdr' "
    "ORDER BY messages.timestamp, messages.id"
)


def is_log(path: str | Path) -> bool:
    """Whether a path names a log, or a folder with one as rosbag2 records it."""
    return Path(path).suffix.lower() in LOGS or bool(_pieces(Path(path)))


def messages_of(path: str | Path) -> Iterator[Logged]:
    """The messages of known types in a log, in order of logging.

    Raises:
        InputError: if it is no such log, is damaged, or unpacks to over 256 MiB.
        MissingDependencyError: without the extra ``ros``.
    """
    for piece in _pieces(Path(path)) or [Path(path)]:
        if piece.suffix.lower() == ".mcap":
            yield from read_log(read_bytes(piece))
            continue
        content = read_bytes(piece)
        with _one_line():
            yield from _database(content) if piece.suffix.lower() == ".db3" else _ros1(piece)


def topics_of(path: str | Path) -> tuple[Topic, ...]:
    """The topics of a log, of all types, by name.

    Raises:
        InputError: as `messages_of` does.
        MissingDependencyError: without the extra ``ros``.
    """
    counts: dict[tuple[str, str], int] = {}
    for piece in _pieces(Path(path)) or [Path(path)]:
        suffix, content = piece.suffix.lower(), read_bytes(piece)
        with _one_line():
            pairs = (
                log_topics(content) if suffix == ".mcap" else _database_topics(content) if suffix == ".db3" else None
            )
            for topic in _ros1_topics(piece) if pairs is None else pairs:
                counts[topic.name, topic.kind] = counts.get((topic.name, topic.kind), 0) + topic.messages
    return tuple(Topic(name, kind, messages) for (name, kind), messages in sorted(counts.items()))


def _pieces(path: Path) -> list[Path]:
    """The files of a rosbag2 folder in order; empty for other folders."""
    if not path.is_dir():
        return []
    return sorted((file for file in path.iterdir() if file.suffix.lower() in (".db3", ".mcap")), key=_in_order)


def _in_order(file: Path) -> tuple[int, str]:
    """Sort key of rosbag2 pieces: log_0, log_1, ..., log_10."""
    number = file.stem.rpartition("_")[2]
    return int(number) if number.isdecimal() else 0, file.name


@contextmanager
def _one_line() -> Iterator[None]:
    try:
        yield
    except (InputError, MissingDependencyError):
        raise
    except Exception as error:  # damaged files make the libraries raise nearly anything
        message = shown(str(error) or type(error).__name__)
        raise InputError(f"expected a bag, found a file that cannot be read ({message})", remedy=_REMEDY) from None


def _database(content: bytes) -> Iterator[Logged]:
    with _opened(content) as connection:
        for topic, kind, time, data in connection.execute(_TABLES):
            if kind in MESSAGE_TYPES:
                yield Logged(topic, kind, time, decoded(data, kind))


def _database_topics(content: bytes) -> list[Topic]:
    with _opened(content) as connection:
        return [Topic(*row) for row in connection.execute(_COUNTS)]


@contextmanager
def _opened(content: bytes) -> Iterator[sqlite3.Connection]:
    connection = sqlite3.connect(":memory:")
    try:
        connection.deserialize(content)
        yield connection
    finally:
        connection.close()


def _ros1_topics(path: Path) -> list[Topic]:
    reader_of, _ = _rosbags()
    with reader_of(path) as reader:
        return [Topic(each.topic, each.msgtype, each.msgcount) for each in reader.connections]


def _rosbags() -> tuple[Any, Any]:
    """The ROS 1 reader with its types.

    Raises:
        MissingDependencyError: without the extra ``ros``.
    """
    try:
        from rosbags.rosbag1 import Reader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingDependencyError.of("ros", "bags of ROS 1 need a library that is not installed") from None
    return Reader, get_typestore(Stores.ROS1_NOETIC)


def _ros1(path: Path) -> Iterator[Logged]:
    reader_of, store = _rosbags()
    from rosbags.typesys import get_types_from_msg

    for unknown in (kind for kind in MESSAGE_TYPES if kind not in store.types):  # of ROS 1 the library lacks tf2_msgs
        store.register(get_types_from_msg(definition(unknown).split("=" * 80)[0], unknown))
    with reader_of(path) as reader:
        for place, chunk in reader.chunks.items():
            reader.chunks[place] = chunk._replace(decompressor=partial(_unpacked, chunk.decompressor))
        wanted = [connection for connection in reader.connections if connection.msgtype in MESSAGE_TYPES]
        if not wanted:
            return
        for connection, time, data in reader.messages(wanted):
            kind: Any = connection.msgtype
            yield Logged(connection.topic, kind, time, store.deserialize_ros1(data, kind))


def _unpacked(plain: Any, data: bytes) -> bytes:
    """The content of a chunk of at most 256 MiB; `plain` decodes uncompressed chunks."""
    room = LARGEST_FILE_BYTES
    if data[:3] == b"BZh":
        text = bz2.BZ2Decompressor().decompress(data, max_length=room + 1)
    elif data[:4] == b"\x04\x22\x4d\x18":
        text = unpacked_lz4(data, room + 1)
    else:
        text = plain(data)
    if len(text) > room:
        raise InputError(f"expected at most {room // 1024 // 1024} MiB of messages, found more", remedy="split the bag")
    return bytes(text)
