"""Bags of ROS 1 (`.bag`) and rosbag2 (`.db3`), as the messages of `log`. The only importer of `rosbags`.

A `.db3` is a SQLite database with messages as ROS 2 writes them; `metadata.yaml` beside it is not needed. Of both kinds
only messages of `log.MESSAGE_TYPES` are looked at, read by definitions that do not come from the file.
"""

from __future__ import annotations

import bz2
import sqlite3
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from micah_plan.errors import InputError, MissingDependencyError, shown
from micah_plan.files import LARGEST_FILE_BYTES, read_bytes
from micah_plan.ros.log import DEFINITIONS, MESSAGE_TYPES, Logged, decoders, unpacked_lz4

_REMEDY = "record it again, or repair it with `rosbag reindex`"
_TABLES = (
    "SELECT topics.name, topics.type, messages.timestamp, messages.data FROM messages "
    "JOIN topics ON messages.topic_id = topics.id WHERE topics.serialization_format = 'cdr' "
    "ORDER BY messages.timestamp, messages.id"
)


def read_bag(path: str | Path) -> Iterator[Logged]:
    """The messages of the known types in a bag, in the order in which they were logged.

    Raises:
        InputError: if it is no such bag, is damaged, or unpacks to over 256 MiB.
        MissingDependencyError: without the extra ``ros``.
    """
    content = read_bytes(path)
    try:
        yield from _database(content) if Path(path).suffix.lower() == ".db3" else _ros1(Path(path))
    except (InputError, MissingDependencyError):
        raise
    except Exception as error:  # damaged files make the libraries raise nearly anything
        said = shown(str(error) or type(error).__name__)
        raise InputError(f"expected a bag, found a file that cannot be read ({said})", remedy=_REMEDY) from None


def _database(content: bytes) -> Iterator[Logged]:
    known = decoders()
    connection = sqlite3.connect(":memory:")
    try:
        connection.deserialize(content)
        for topic, kind, time, data in connection.execute(_TABLES):
            if kind in known:
                yield Logged(topic, kind, time, known[kind](data))
    finally:
        connection.close()


def _ros1(path: Path) -> Iterator[Logged]:
    try:
        from rosbags.rosbag1 import Reader
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise MissingDependencyError("bags of ROS 1 need an extra: pip install 'micah-plan[ros]'") from None
    store = get_typestore(Stores.ROS1_NOETIC)
    for unknown in (kind for kind in MESSAGE_TYPES if kind not in store.types):  # of ROS 1 the library lacks tf2_msgs
        store.register(get_types_from_msg(DEFINITIONS[unknown], unknown))
    with Reader(path) as reader:
        for place, chunk in reader.chunks.items():
            reader.chunks[place] = chunk._replace(decompressor=partial(_unpacked, chunk.decompressor))
        wanted = [connection for connection in reader.connections if connection.msgtype in MESSAGE_TYPES]
        if not wanted:
            return
        for connection, time, data in reader.messages(wanted):
            kind: Any = connection.msgtype
            yield Logged(connection.topic, kind, time, store.deserialize_ros1(data, kind))


def _unpacked(plain: Any, data: bytes) -> bytes:
    """The content of a chunk of at most 256 MiB; `plain` is what a chunk that is not packed goes through."""
    room = LARGEST_FILE_BYTES
    if data[:3] == b"BZh":
        found = bz2.BZ2Decompressor().decompress(data, max_length=room + 1)
    elif data[:4] == b"\x04\x22\x4d\x18":
        found = unpacked_lz4(data, room + 1)
    else:
        found = plain(data)
    if len(found) > room:
        raise InputError(f"expected at most {room // 1024 // 1024} MiB of messages, found more", remedy="split the bag")
    return bytes(found)
