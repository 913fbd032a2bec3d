"""MCAP files with ROS 2 messages. The only importer of `mcap`, `lz4` and `zstandard`.

Messages are bytes (CDR) that are converted to values and back by the definitions of the library `rosbags`, not by those
in the file; only messages of `MESSAGE_TYPES` are read.

Chunks are unpacked here, so that a file cannot ask for more memory than its stated limit.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, get_args

import numpy as np

from micah_plan.errors import InputError, MissingDependencyError, shown
from micah_plan.files import LARGEST_FILE_BYTES

NANOSECONDS = 1_000_000_000

MessageType = Literal[
    "geometry_msgs/msg/PointStamped",
    "geometry_msgs/msg/PoseArray",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/Vector3Stamped",
    "nav_msgs/msg/Odometry",
    "tf2_msgs/msg/TFMessage",
    "sensor_msgs/msg/JointState",
    "std_msgs/msg/Float64",
    "std_msgs/msg/Float64MultiArray",
    "std_msgs/msg/Int64",
    "std_msgs/msg/String",
    "trajectory_msgs/msg/JointTrajectory",
]

MESSAGE_TYPES: tuple[MessageType, ...] = get_args(MessageType)

_REMEDY = "record it again, or repair it with `mcap recover`"


@dataclass(frozen=True)
class Logged:
    """A message in a log.

    Attributes:
        topic: its name, such as ``/door/pose``.
        kind: type of the message.
        time: at which it was logged [ns], at least 0.
        message: its content: to write, a dict by field; as read, an object with the fields as attributes.
    """

    topic: str
    kind: MessageType
    time: int
    message: Any


@dataclass(frozen=True)
class Topic:
    """A topic of a log: its name, message type and number of messages."""

    name: str
    kind: str
    messages: int


@lru_cache(maxsize=1)
def known_types() -> Any:
    """The messages of ROS 2 that the library knows.

    Raises:
        MissingDependencyError: without the extra ``ros``.
    """
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingDependencyError.of("ros", "ROS logs need libraries that are not installed") from None
    return get_typestore(Stores.ROS2_HUMBLE)


def definition(kind: str) -> str:
    """The definition of a message with all nested types, each once."""
    return str(known_types().generate_msgdef(kind, ros_version=2)[0])


def decoded(data: bytes, kind: MessageType) -> Any:
    """The decoded message."""
    return known_types().deserialize_cdr(data, kind)


def encoded(message: dict[str, Any], kind: MessageType) -> bytes:
    """The bytes of a message, given by field."""
    return bytes(known_types().serialize_cdr(_made(message, kind), kind))


def _made(value: Any, kind: str) -> Any:
    """A library message from fields, including nested messages and lists of numbers."""
    fields = {}
    for name, (_, what) in known_types().fielddefs[kind][1]:
        field = value[name]
        if isinstance(field, dict):
            fields[name] = _made(field, what)
        elif isinstance(field, list) and what[0][0].name == "NAME":
            fields[name] = [_made(item, what[0][1]) for item in field]
        elif isinstance(field, list) and what[0][1][0] != "string":
            fields[name] = np.array(field, dtype=what[0][1][0])
        else:
            fields[name] = field
    return known_types().types[kind](**fields)


def stamp_ns(header: Any, logged: int) -> int:
    """The time of a message [ns]: its stamp, or when it was logged if it has none."""
    stamp = int(header.stamp.sec) * NANOSECONDS + int(header.stamp.nanosec)
    return stamp if stamp else logged


def header_at(time: int, frame: str) -> dict[str, Any]:
    """A ``std_msgs/Header`` to write; `time` in ns."""
    return {"stamp": split_time(time), "frame_id": frame}


def split_time(time: int) -> dict[str, int]:
    """A time [ns] in the message format."""
    return {"sec": time // NANOSECONDS, "nanosec": time % NANOSECONDS}


def write_log(messages: Sequence[Logged]) -> bytes:
    """The content of an MCAP file with these messages, in this order; the same messages give the same bytes.

    Raises:
        MissingDependencyError: without the extra ``ros``.
    """
    _require()
    from mcap.writer import Writer

    buffer = io.BytesIO()
    writer = Writer(buffer)
    writer.start(profile="ros2")
    schemas: dict[MessageType, int] = {}
    channels: dict[str, int] = {}
    for number, logged in enumerate(messages):
        kind = logged.kind
        if kind not in schemas:
            schemas[kind] = writer.register_schema(kind, "ros2msg", definition(kind).encode())
        if logged.topic not in channels:
            channels[logged.topic] = writer.register_channel(logged.topic, "cdr", schemas[kind])
        content, time = encoded(logged.message, kind), logged.time
        writer.add_message(channels[logged.topic], time, content, publish_time=time, sequence=number)
    writer.finish()
    return buffer.getvalue()


def read_log(content: bytes) -> Iterator[Logged]:
    """The messages of the known types in an MCAP file, in the order of the file.

    Raises:
        InputError: if it is no MCAP file, is damaged, or unpacks to over 256 MiB.
        MissingDependencyError: without the extra ``ros``.
    """
    _require()
    try:
        yield from _messages(content)
    except InputError:
        raise
    except Exception as error:  # damaged files make the libraries raise nearly anything
        message = shown(str(error) or type(error).__name__)
        raise InputError(f"expected an MCAP file, found one that cannot be read ({message})", remedy=_REMEDY) from None


def log_topics(content: bytes) -> list[Topic]:
    """The topics of an MCAP file, of all types.

    Raises:
        MissingDependencyError: without the extra ``ros``.
    """
    _require()
    from mcap.records import Channel, Message, Schema

    kinds: dict[int, str] = {0: "unknown"}
    channels: dict[int, tuple[str, str]] = {}
    counts: dict[int, int] = {}
    for record in _records(content):
        if isinstance(record, Schema):
            kinds[record.id] = record.name
        elif isinstance(record, Channel):
            channels[record.id] = record.topic, kinds.get(record.schema_id, "unknown")
        elif isinstance(record, Message):
            counts[record.channel_id] = counts.get(record.channel_id, 0) + 1
    return [Topic(*names, counts.get(number, 0)) for number, names in channels.items()]


def _require() -> None:
    known_types()
    try:
        import mcap.writer  # noqa: F401 - only whether it is there
    except ImportError:
        raise MissingDependencyError.of("ros", "ROS logs need libraries that are not installed") from None


def _messages(content: bytes) -> Iterator[Logged]:
    from mcap.records import Channel, Message, Schema

    kinds: dict[int, MessageType] = {}
    channels: dict[int, tuple[str, MessageType]] = {}
    for record in _records(content):
        if isinstance(record, Schema):
            if record.name in MESSAGE_TYPES:
                kinds[record.id] = record.name
        elif isinstance(record, Channel):
            if record.schema_id in kinds and record.message_encoding == "cdr":
                channels[record.id] = record.topic, kinds[record.schema_id]
        elif isinstance(record, Message) and record.channel_id in channels:
            topic, kind = channels[record.channel_id]
            yield Logged(topic, kind, record.log_time, decoded(record.data, kind))


def _records(content: bytes) -> Iterator[Any]:
    """All records, including those in chunks."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    room = LARGEST_FILE_BYTES
    for record in StreamReader(io.BytesIO(content), emit_chunks=True, record_size_limit=len(content)).records:
        if not isinstance(record, Chunk):
            yield record
            continue
        data = _unpacked(record, room)
        room -= len(data)
        plain = Chunk("", data, record.message_end_time, record.message_start_time, 0, len(data))
        yield from breakup_chunk(plain)


def unpacked_lz4(data: bytes, most: int) -> bytes:
    """The content of an LZ4 frame, limited to `most` bytes."""
    import lz4.frame

    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most))


def _unpacked(chunk: Any, room: int) -> bytes:
    """The content of a chunk, of at most `room` bytes."""
    if chunk.compression == "zstd":
        import zstandard

        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
            data = reader.read(room + 1)
    elif chunk.compression == "lz4":
        data = unpacked_lz4(chunk.data, room + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise InputError(f"a chunk is packed by {shown(chunk.compression)}", remedy="pack it by zstd or lz4")
    if len(data) > room:
        limit = LARGEST_FILE_BYTES // 1024 // 1024
        raise InputError(f"expected at most {limit} MiB of messages, found more", remedy="split the recording")
    return bytes(data)
