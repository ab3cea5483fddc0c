"""Logs in MCAP: a column for each number of a topic's messages, in JSON or of ROS 2."""

# Messages hold what their writer chose, and the package lz4 has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownArgumentType=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false

from __future__ import annotations

import io
import json
import math
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from flexhinf.errors import refuse_if
from flexhinf.identification.log_columns import (
    LARGEST,
    FileColumns,
    Loaded,
    first_place,
    foreign_errors,
    nanoseconds,
    no_number,
    refuse_rows,
    row_place,
    stamps_of_numbers,
)
from flexhinf.validation import extra_package

#: Most bytes of a chunk, and of all of them, when they are unpacked.
LARGEST_CHUNK, LARGEST_UNPACKED = 1 << 28, LARGEST

#: Most bytes of a message with signals: longer ones are pictures or maps, and their topics have no columns.
LARGEST_MESSAGE = 1 << 18

#: Most columns, and most numbers in all of them: an hour of a robot with seven joints at 1 kHz.
MOST_COLUMNS, MOST_NUMBERS = 10_000, 100_000_000

#: Most numbers of an array in a message: the joints of a robot, not the points of a cloud.
MOST_ELEMENTS = 100

#: What to try where a file has more than a log of a robot.
ROBOT_ALONE = "a file with the robot's topics alone, or a shorter one"

#: The name under which the times of an MCAP file's messages are a column, and that of those in their headers.
LOG_TIME, STAMP = "time", "header/stamp"


def mcap_columns(path: Path) -> FileColumns:
    """A column for each number of a topic's messages: ``topic/field``, ``joint_states/position/elbow``.

    Messages in JSON, and those of ROS 2. In messages with arrays and as many names, as those of joints, the names stand
    in the column's; else the places from 0 on. The times of the messages are the column `LOG_TIME`, in nanoseconds.
    With the column ``topic/header/stamp`` as time each topic has the times of its headers, and those of the log where
    it has no headers.
    """
    columns: dict[str, _Values] = {}
    stamped = set[str]()
    with foreign_errors(path, "MCAP"):
        decoders: dict[int, Callable[[bytes], Any] | None] = {}
        total = 0
        for schema, channel, message in _messages(path):
            if channel.id not in decoders:
                decoders[channel.id] = _decoder(channel.message_encoding, schema)
            if len(message.data) > LARGEST_MESSAGE:
                decoders[channel.id] = None
                for name in [name for name, values in columns.items() if values.channel == channel.id]:
                    columns.pop(name)
            decode, topic = decoders[channel.id], channel.topic.strip("/")
            content = decode(message.data) if decode else {}
            stamp = _stamp(content)
            numbers = list(_fields(topic, content)) if decode else []
            if stamp is not None:
                stamped.add(f"{topic}/{STAMP}")
                numbers.append((f"{topic}/{STAMP}", float(stamp)))
            total += len(numbers)
            for name, value in numbers:
                column = columns.setdefault(name, _Values(channel.id, array("q"), array("q"), array("d")))
                column.times.append(message.log_time)
                column.stamps.append(message.log_time if stamp is None else stamp)
                column.values.append(value)
            for count, most, what in (
                (len(columns), MOST_COLUMNS, "columns"),
                (total, MOST_NUMBERS, "numbers"),
            ):
                refuse_if(
                    count > most,
                    f"{path.name} has too many {what}.",
                    f"expected at most {most} in all messages, got more",
                    ROBOT_ALONE,
                )
    names = tuple(columns)

    def load(time: Sequence[int], places: Sequence[int]) -> Loaded:
        own = time != [0]
        by_header = own and names[time[0] - 1] in stamped
        chosen = [columns[names[k - 1]] for k in places]
        if own and not by_header:
            chosen += [columns[names[k - 1]] for k in time]
        every = [np.array(each.stamps if by_header else each.times, dtype=np.int64) for each in chosen]
        stamps = np.unique(np.concatenate(every)) if every else np.zeros(0, dtype=np.int64)
        table = np.full((len(stamps), len(chosen)), np.nan)
        for k, (times, each) in enumerate(zip(every, chosen)):
            again = np.diff(np.sort(times)) == 0
            refuse_if(
                again.any(),
                f"{path.name}: two messages of one topic have the same time.",
                f"expected increasing times of {names[(*places, *time)[k] - 1]!r}, got {int(again.sum())} repeated",
                "the times of the log, which need no time='...'"
                if by_header
                else "a log with one message of a topic at a time",
            )
            table[np.searchsorted(stamps, times), k] = each.values
        infinite = first_place(np.asarray(np.isinf(table).any(axis=1)))
        if infinite is not None:
            raise no_number(path.name, "of a message", row_place(infinite), math.inf)
        if not own or by_header:
            return Loaded(*stamps_of_numbers(stamps), table, row_place)
        parts, values = table[:, len(places) :], table[:, : len(places)]
        known = np.isfinite(parts).all(axis=1)
        written = parts[known, 0] if len(time) == 1 else nanoseconds(*parts[known].T)
        return Loaded(*stamps_of_numbers(written), values[known], row_place)

    headings = (f"{name} [ns]" if name in stamped else name for name in names)
    return FileColumns(path, (f"{LOG_TIME} [ns]", *headings) if names else (), load)


class _Values(NamedTuple):
    """Numbers of a column, its channel, and the times of the messages in the log and in their headers, ns."""

    channel: int
    times: array[int]
    stamps: array[int]
    values: array[float]


def _stamp(message: Any) -> int | None:
    """The stamp of a message's header, ns, as ROS writes it; None where it has none."""

    def entry(of: Any, *names: str) -> Any:
        found = (of.get(name) if isinstance(of, Mapping) else getattr(of, name, None) for name in names)
        return next((value for value in found if value is not None), None)

    stamp = entry(entry(message, "header"), "stamp")
    parts = entry(stamp, "sec", "secs"), entry(stamp, "nanosec", "nsec", "nsecs")
    if not all(isinstance(part, int) and abs(part) < 1 << 33 for part in parts):
        return None
    return 1_000_000_000 * parts[0] + parts[1]


def _messages(path: Path) -> Iterator[tuple[Any, Any, Any]]:
    """Schema, channel and message of each message, in the order of the file.

    Before anything is unpacked the footer says how many there are, and how many bytes; no chunk unpacks to more than
    `LARGEST_CHUNK`, and all of them to no more than `LARGEST_UNPACKED`.
    """
    make_reader = extra_package("mcap.reader", "log", "A log in MCAP needs another package.").make_reader
    from mcap.records import Channel, Chunk, Message, Schema
    from mcap.stream_reader import StreamReader

    schemas: dict[int, Any] = {0: None}
    channels: dict[int, Any] = {}
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        if summary is not None and summary.statistics is not None:
            refuse_rows(path.name, summary.statistics.message_count)
            _refuse_bytes(path.name, sum(chunk.uncompressed_size for chunk in summary.chunk_indexes))
        file.seek(0)
        found = unpacked = 0
        for record in StreamReader(file, emit_chunks=True, record_size_limit=LARGEST).records:
            packed = [record]
            if isinstance(record, Chunk):
                content = io.BytesIO(_unpacked(path.name, record))
                unpacked += content.getbuffer().nbytes
                _refuse_bytes(path.name, unpacked)  # the footer may be wrong
                packed = _records(
                    StreamReader(content, skip_magic=True, record_size_limit=LARGEST_CHUNK), content
                )
            for one in packed:
                if isinstance(one, Schema):
                    schemas[one.id] = one
                elif isinstance(one, Channel):
                    channels[one.id] = one
                elif isinstance(one, Message):
                    found += 1
                    refuse_rows(path.name, found)
                    channel = channels[one.channel_id]
                    yield schemas[channel.schema_id], channel, one


def _refuse_bytes(name: str, unpacked: int) -> None:
    refuse_if(
        unpacked > LARGEST_UNPACKED,
        f"{name} is too large.",
        f"expected messages of at most {LARGEST_UNPACKED} bytes when they are unpacked, got {unpacked} or more",
        ROBOT_ALONE,
    )


def _records(reader: Any, content: io.BytesIO) -> Iterator[Any]:
    """The records of a chunk, which ends without a footer."""
    size, records = content.getbuffer().nbytes, reader.records
    while content.tell() < size:
        yield next(records)


def _unpacked(name: str, chunk: Any) -> bytes:
    """The records of a chunk, unpacked as far as its size is allowed."""
    most = LARGEST_CHUNK + 1
    if chunk.compression == "zstd":
        import zstandard

        content = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(most)
    elif chunk.compression == "lz4":
        import lz4.frame

        content = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=most)
    else:
        content = chunk.data
    refuse_if(
        len(content) == most,
        f"{name} is too large.",
        f"expected chunks of at most {LARGEST_CHUNK} bytes, got a larger one",
        "the same messages in smaller chunks",
    )
    return content


def _decoder(encoding: str, schema: Any) -> Callable[[bytes], Any] | None:
    if encoding == "json":
        return json.loads
    if encoding == "cdr":
        factory = extra_package("mcap_ros2.decoder", "log", "A log of ROS 2 needs another package.")
        return factory.DecoderFactory().decoder_for(encoding, schema)
    return None


def _fields(name: str, message: Any) -> Iterator[tuple[str, float]]:
    """Every number of a message, with the path to it."""
    if isinstance(message, (bool, int, float)):
        yield name, float(message)
    elif _is_array(message):
        if len(message) <= MOST_ELEMENTS:
            for k, entry in enumerate(message):
                yield from _fields(f"{name}/{k}", entry)
    elif isinstance(message, Mapping) or hasattr(message, "__slots__"):
        entries = (
            message if isinstance(message, Mapping) else {k: getattr(message, k) for k in message.__slots__}
        )
        labels = entries.get("name")
        labels = (
            labels if isinstance(labels, list) and all(isinstance(label, str) for label in labels) else []
        )
        for key, entry in entries.items():
            if labels and _is_array(entry) and len(entry) == len(labels):
                for label, element in zip(labels, entry):
                    yield from _fields(f"{name}/{key}/{label}", element)
            else:
                yield from _fields(f"{name}/{key}", entry)


def _is_array(value: object) -> bool:
    return (
        hasattr(value, "__len__")
        and hasattr(value, "__getitem__")
        and not isinstance(value, (str, bytes, Mapping))
    )
